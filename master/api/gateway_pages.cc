#include <algorithm>
#include <chrono>
#include <functional>
#include <future>
#include <iterator>
#include <memory>
#include <numeric>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/master.h>

namespace iotcloud::master {

namespace {

constexpr std::int32_t most_changes = 10'000;

const discovery::GatewayStatus& find(const std::vector<discovery::GatewayStatus>& gateways,
                                     const discovery::GatewayId& id) {
  const auto at = std::find_if(gateways.begin(), gateways.end(), [&](const auto& g) { return g.record.id == id; });
  if (at == gateways.end()) throw config::Error(fmt::format("no gateway \"{}\"", id));
  return *at;
}

std::string unanswered(const GatewayAccess& access) {
  return fmt::format("no answer within {} s, in which others were asked, too; ask for it alone",
                     access.all_answers_limit.count() / 1000);
}

/// Bytes of what all gateways answered together; less than a client of this master reads.
constexpr std::size_t most_together = std::size_t{60} << 20;

std::size_t bytes_of(const DriverChange& change) {
  return sizeof change + change.instance.str().size() + change.driver.str().size() + change.state.size() +
         change.reason.size();
}
std::size_t bytes_of(const GatewayPlugin& known) {
  const auto& plugin = known.plugin;
  return sizeof known + plugin.file.size() + plugin.sha256.size() + plugin.signed_by.size() + plugin.problem.size() +
         plugin.declaration.size();
}

std::size_t bytes_of(const CarriedByGateway& carried) {
  using Range = std::pair<const double, std::uint64_t>;
  return sizeof carried + carried.messages.host.size() + carried.messages.round_trips.size() * sizeof(Range);
}

/// What gateways answer to one question, as it comes. Thread safe.
template <typename Item>
class Gathered {
 public:
  /// \param cut leaves out what is not asked for
  explicit Gathered(std::function<void(std::vector<Item>&)> cut) : cut_(std::move(cut)) {}

  void add(const discovery::GatewayId& gateway, std::vector<Item> items) IOTCLOUD_EXCLUDES(mutex_) {
    cut_(items);
    const auto size = bytes_of_all(items);
    const config::MutexLock lock(mutex_);
    if (bytes_ + size > most_together) {
      silent_[gateway] = fmt::format(
          "its answer of {} MB is more than has room beside those of the others, {} MB together; ask for it alone",
          (size >> 20) + 1, most_together >> 20);
      return;
    }
    std::move(items.begin(), items.end(), std::back_inserter(items_));
    cut_(items_);
    bytes_ = bytes_of_all(items_);
  }
  void fail(const discovery::GatewayId& gateway, std::string why) IOTCLOUD_EXCLUDES(mutex_) {
    const config::MutexLock lock(mutex_);
    silent_[gateway] = std::move(why);
  }
  /// \param silent gets the gateways without an answer that counts
  std::vector<Item> take(std::map<discovery::GatewayId, std::string>& silent) IOTCLOUD_EXCLUDES(mutex_) {
    const config::MutexLock lock(mutex_);
    silent.merge(silent_);
    return std::move(items_);
  }

 private:
  static std::size_t bytes_of_all(const std::vector<Item>& items) {
    return std::accumulate(items.begin(), items.end(), std::size_t{0},
                           [](std::size_t sum, const Item& item) { return sum + bytes_of(item); });
  }

  const std::function<void(std::vector<Item>&)> cut_;
  config::Mutex mutex_;
  std::vector<Item> items_ IOTCLOUD_GUARDED_BY(mutex_);
  std::size_t bytes_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< of items_
  std::map<discovery::GatewayId, std::string> silent_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Puts a question to gateways, all at the same time. \param gateways empty: all. \param cut see Gathered. \return what
/// all answered
/// \param silent gets the gateways that did not answer
template <typename Item, typename Question>
std::vector<Item> ask_gateways(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                               const std::vector<discovery::GatewayId>& gateways,
                               std::map<discovery::GatewayId, std::string>& silent, Question question,
                               std::function<void(std::vector<Item>&)> cut) {
  const auto known = master.gateways();
  std::vector<const discovery::GatewayStatus*> asked;
  asked.reserve(gateways.empty() ? known.size() : gateways.size());
  for (const auto& id : gateways) asked.push_back(&find(known, id));
  if (gateways.empty()) {
    for (const auto& gateway : known) asked.push_back(&gateway);
  }
  // An answer is added where it comes, so that no more than the threads have at once waits for the others.
  const auto gathered = std::make_shared<Gathered<Item>>(std::move(cut));
  std::vector<std::pair<discovery::GatewayId, std::future<void>>> answers;
  answers.reserve(asked.size());
  const auto until = std::chrono::steady_clock::now() + access.all_answers_limit;
  for (const auto* gateway : asked) {
    answers.emplace_back(gateway->record.id, asks.ask([gateway = *gateway, &access, until, question, gathered] {
      const auto& id = gateway.record.id;
      if (std::chrono::steady_clock::now() >= until)
        return gathered->fail(id, unanswered(access));  // hardly anybody waits
      try {
        gathered->add(id, question(address_of(gateway, access), id));
      } catch (const config::Error& e) {
        gathered->fail(id, e.what());
      }
    }));
  }
  for (auto& [id, answer] : answers) {
    if (answer.wait_until(until) != std::future_status::ready) silent[id] = unanswered(access);
  }
  return gathered->take(silent);
}

}  // namespace

DriverHistory read_history(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                           const std::vector<std::string>& instances, const std::vector<discovery::GatewayId>& gateways,
                           std::int32_t most) {
  const auto kept = static_cast<std::size_t>(most <= 0 ? most_changes : std::min(most, most_changes));
  const auto cut = [instances, kept](std::vector<DriverChange>& changes) {
    std::erase_if(changes, [&](const DriverChange& change) {
      const auto begins = [&](const std::string& id) { return change.instance.str().starts_with(id); };
      return !instances.empty() && std::none_of(instances.begin(), instances.end(), begins);
    });
    std::stable_sort(changes.begin(), changes.end(), [](const auto& a, const auto& b) {
      return std::tie(a.time_ms, a.gateway) < std::tie(b.time_ms, b.gateway);
    });
    if (changes.size() > kept) changes.erase(changes.begin(), changes.end() - static_cast<std::ptrdiff_t>(kept));
  };
  DriverHistory history;
  // The gateways are asked for all instances: the beginning of an id may belong to an instance that is gone, which only
  // they know.
  history.changes = ask_gateways<DriverChange>(
      master, access, asks, gateways, history.silent,
      [limit = access.answer_limit](const SiteAddress& site, const discovery::GatewayId& gateway) {
        return site_changes(site, gateway, {}, limit);
      },
      cut);
  return history;
}

GatewayPlugins read_plugins(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                            const std::vector<discovery::GatewayId>& gateways) {
  GatewayPlugins answer;
  answer.plugins = ask_gateways<GatewayPlugin>(
      master, access, asks, gateways, answer.silent,
      [limit = access.answer_limit](const SiteAddress& site, const discovery::GatewayId& gateway) {
        return site_plugins(site, gateway, limit);
      },
      [](std::vector<GatewayPlugin>& plugins) {
        std::stable_sort(plugins.begin(), plugins.end(),
                         [](const auto& a, const auto& b) { return a.gateway < b.gateway; });
      });
  return answer;
}

std::vector<CarriedByGateway> read_carried(const Master& master, const GatewayAccess& access, GatewayAsks& asks) {
  std::vector<discovery::GatewayId> asked;
  for (const auto& gateway : master.gateways()) {
    if (gateway.alive && !gateway.original) asked.emplace_back(gateway.record.id);
  }
  if (asked.empty()) return {};
  std::map<discovery::GatewayId, std::string> silent;  // they have no rate until they answer twice
  return ask_gateways<CarriedByGateway>(
      master, access, asks, asked, silent,
      [limit = access.answer_limit](const SiteAddress& site, const discovery::GatewayId& gateway) {
        std::vector<CarriedByGateway> of_hosts;
        for (auto& messages : site_carried(site, gateway, limit)) of_hosts.push_back({gateway, std::move(messages)});
        return of_hosts;
      },
      [](std::vector<CarriedByGateway>&) {});
}

LogPart read_log(const Master& master, const GatewayAccess& access, const discovery::GatewayId& gateway,
                 const discovery::InstanceId& instance, const std::string& position, std::int32_t most_bytes) {
  const auto known = master.gateways();
  return site_read_log(address_of(find(known, gateway), access), gateway, instance, position, most_bytes,
                       access.answer_limit);
}

discovery::ChannelLook look_at_channel(const Master& master, const GatewayAccess& access,
                                       const discovery::GatewayId& gateway, const discovery::LookRequest& request) {
  const auto known = master.gateways();
  return site_look_at_channel(address_of(find(known, gateway), access), gateway, request, access.answer_limit);
}

discovery::ChannelLook hand_message(const Master& master, const GatewayAccess& access,
                                    const discovery::GatewayId& gateway, const discovery::HandedMessage& message) {
  const auto known = master.gateways();
  return site_hand_message(address_of(find(known, gateway), access), gateway, message, access.answer_limit);
}

}  // namespace iotcloud::master
