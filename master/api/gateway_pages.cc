#include <algorithm>
#include <chrono>
#include <future>
#include <iterator>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/master.h>

namespace iotcloud::master {

namespace {

constexpr std::chrono::milliseconds answer_limit{3000};
/// For the answers of all gateways; those whose answers are missing by then are named.
constexpr std::chrono::seconds all_limit{15};
constexpr std::int32_t most_changes = 10'000;

const discovery::GatewayStatus& find(const std::vector<discovery::GatewayStatus>& gateways,
                                     const discovery::GatewayId& id) {
  const auto at = std::find_if(gateways.begin(), gateways.end(), [&](const auto& g) { return g.record.id == id; });
  if (at == gateways.end()) throw config::Error(fmt::format("no gateway \"{}\"", id));
  return *at;
}

std::string unanswered() {
  return fmt::format("no answer within {} s, in which others were asked, too; ask for it alone", all_limit.count());
}

/// What one gateway answered. An exception does not cross threads: they would share its text.
template <typename Item>
struct GatewayAnswer {
  std::vector<Item> items;
  std::string failure;  ///< why there is no answer; empty: there is one
};

/// Puts a question to gateways, all at the same time. \param gateways empty: all. \return what all answered
/// \param silent gets the gateways that did not answer
template <typename Item, typename Question>
std::vector<Item> ask_gateways(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                               const std::vector<discovery::GatewayId>& gateways,
                               std::map<discovery::GatewayId, std::string>& silent, Question question) {
  const auto known = master.gateways();
  std::vector<const discovery::GatewayStatus*> asked;
  for (const auto& id : gateways) asked.push_back(&find(known, id));
  if (gateways.empty()) {
    for (const auto& gateway : known) asked.push_back(&gateway);
  }
  std::vector<std::pair<discovery::GatewayId, std::future<GatewayAnswer<Item>>>> answers;
  const auto until = std::chrono::steady_clock::now() + all_limit;
  for (const auto* gateway : asked) {
    answers.emplace_back(gateway->record.id,
                         asks.ask([gateway = *gateway, &access, until, question]() -> GatewayAnswer<Item> {
                           if (std::chrono::steady_clock::now() >= until)
                             return {{}, unanswered()};  // hardly anybody waits for it any more
                           try {
                             return {question(address_of(gateway, access), gateway.record.id), ""};
                           } catch (const config::Error& e) {
                             return {{}, e.what()};
                           }
                         }));
  }
  std::vector<Item> all;
  for (auto& [id, answer] : answers) {
    if (answer.wait_until(until) != std::future_status::ready) {
      silent[id] = unanswered();
      continue;
    }
    GatewayAnswer<Item> told = answer.get();
    if (!told.failure.empty()) silent[id] = std::move(told.failure);
    std::move(told.items.begin(), told.items.end(), std::back_inserter(all));
  }
  return all;
}

}  // namespace

DriverHistory read_history(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                           const std::vector<std::string>& instances, const std::vector<discovery::GatewayId>& gateways,
                           std::int32_t most) {
  DriverHistory history;
  // The gateways are asked for all instances: the beginning of an id may belong to an instance that is gone, which only
  // they know.
  history.changes = ask_gateways<DriverChange>(master, access, asks, gateways, history.silent,
                                               [](const SiteAddress& site, const discovery::GatewayId& gateway) {
                                                 return site_changes(site, gateway, {}, answer_limit);
                                               });
  std::erase_if(history.changes, [&](const DriverChange& change) {
    const auto begins = [&](const std::string& id) { return change.instance.str().starts_with(id); };
    return !instances.empty() && std::none_of(instances.begin(), instances.end(), begins);
  });
  std::stable_sort(history.changes.begin(), history.changes.end(),
                   [](const auto& a, const auto& b) { return a.time_ms < b.time_ms; });
  const auto kept = static_cast<std::size_t>(most <= 0 ? most_changes : std::min(most, most_changes));
  if (const auto count = history.changes.size(); count > kept) {
    history.changes.erase(history.changes.begin(), history.changes.end() - static_cast<std::ptrdiff_t>(kept));
  }
  return history;
}

GatewayPlugins read_plugins(const Master& master, const GatewayAccess& access, GatewayAsks& asks,
                            const std::vector<discovery::GatewayId>& gateways) {
  GatewayPlugins answer;
  answer.plugins = ask_gateways<GatewayPlugin>(master, access, asks, gateways, answer.silent,
                                               [](const SiteAddress& site, const discovery::GatewayId& gateway) {
                                                 return site_plugins(site, gateway, answer_limit);
                                               });
  return answer;
}

LogPart read_log(const Master& master, const GatewayAccess& access, const discovery::GatewayId& gateway,
                 const discovery::InstanceId& instance, const std::string& position, std::int32_t most_bytes) {
  const auto known = master.gateways();
  return site_read_log(address_of(find(known, gateway), access), gateway, instance, position, most_bytes, answer_limit);
}

discovery::ChannelLook look_at_channel(const Master& master, const GatewayAccess& access,
                                       const discovery::GatewayId& gateway, const discovery::LookRequest& request) {
  const auto known = master.gateways();
  return site_look_at_channel(address_of(find(known, gateway), access), gateway, request, answer_limit);
}

discovery::ChannelLook hand_message(const Master& master, const GatewayAccess& access,
                                    const discovery::GatewayId& gateway, const discovery::HandedMessage& message) {
  const auto known = master.gateways();
  return site_hand_message(address_of(find(known, gateway), access), gateway, message, answer_limit);
}

}  // namespace iotcloud::master
