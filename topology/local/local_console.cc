#include <algorithm>
#include <map>
#include <tuple>
#include <utility>

#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/host/round_trips.h>
#include <iotcloud/master/console/answers.h>
#include <iotcloud/master/console/console.h>
#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/peer_user.h>
#include <iotcloud/topology/local/local_console.h>
#include <iotcloud/topology/local/recent_lines.h>
#include <iotcloud/topology/worker/page_requests.h>

namespace iotcloud::local {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::chrono::milliseconds answer_limit{3'000};
constexpr std::size_t most_changes = 10'000;
constexpr std::size_t most_log_bytes = 65'536;

/// Asks the cluster's parts themselves.
class LocalCalls final : public master::ConsoleCalls {
 public:
  explicit LocalCalls(LocalCluster& cluster) : cluster_(cluster) {}

  std::string authenticate(const master::ConsoleCaller&, const std::string&) override {
    return "no token is asked for";
  }

  std::string call(const master::ConsoleCaller& caller, const std::string& call, const std::string& json) override {
    const auto given = master::read_arguments(call, json);
    try {
      return answer(caller, call, given);
    } catch (const nlohmann::json::exception& error) {
      throw config::Error("the call " + call + ": " + error.what());
    }
  }

 private:
  std::string answer(const master::ConsoleCaller& caller, const std::string& call, const nlohmann::json& given) {
    const bool may_act = caller.user && rpc::is_trusted_user(*caller.user, {});
    if ((call == "order" || call == "topology" || call == "order_of") && !may_act)
      throw config::Error("only root and the user of this process may do that");
    if (call == "order") {
      return master::answer_of(
          cluster_.master()
              .give(master::text_of(given, "order"), given.value("with", nlohmann::json::object()).dump())
              .result);
    }
    if (call == "topology") return master::answer_of(cluster_.master().order(master::read_topology_order(given)));
    if (call == "history") return history(given);
    if (call == "look") return look(given);
    if (call == "order_of") return order_of(given);
    if (call == "worker") return worker_page(given);
    if (call == "plugins") return plugins(given);
    if (call == "log") {
      const auto part = RecentLines::read(master::text_of(given, "position"), most_log_bytes);
      return discovery::to_text(Json{{"text", part.text}, {"position", part.position}});
    }
    throw config::Error("the console has no call \"" + call + "\" in one process");
  }

  gateway::Gateway& find(const std::string& id) {
    auto* const gateway = cluster_.gateway(discovery::GatewayId(id));
    if (gateway == nullptr) throw config::Error("no gateway \"" + id + "\"");
    return *gateway;
  }

  std::string history(const nlohmann::json& given) {
    const auto wanted = master::texts_of(given, "instances");
    master::DriverHistory history;
    for (const auto& status : cluster_.master().gateways()) {
      for (const auto& change : find(status.record.id).changes(discovery::InstanceId())) {
        if (!wanted.empty() && std::find(wanted.begin(), wanted.end(), change.instance.str()) == wanted.end()) continue;
        history.changes.push_back(
            {status.record.id, change.instance, change.driver, to_string(change.state), change.reason, change.time_ms});
      }
    }
    auto& changes = history.changes;
    std::stable_sort(changes.begin(), changes.end(),
                     [](const auto& a, const auto& b) { return a.time_ms < b.time_ms; });
    if (changes.size() > most_changes)
      changes.erase(changes.begin(), changes.end() - static_cast<std::ptrdiff_t>(most_changes));
    return master::answer_of(history);
  }

  std::string look(const nlohmann::json& given) {
    gateway::ChannelQuestion question;
    question.look = discovery::from_json<discovery::LookRequest>(given, "a look");
    return master::answer_of(find(master::text_of(given, "gateway")).ask(question, answer_limit));
  }

  std::string order_of(const nlohmann::json& given) {
    for (const auto& placed : cluster_.master().orders()) {
      if (placed.order.instance == master::text_of(given, "instance") &&
          placed.gateway == master::text_of(given, "gateway"))
        return discovery::to_text(discovery::to_json<Json>(placed.order));
    }
    throw config::Error("there is no order for this instance");
  }

  std::string plugins(const nlohmann::json& given) {
    master::GatewayPlugins all;
    for (const auto& id : master::texts_of(given, "gateways")) {
      for (auto& plugin : find(id).known_plugins())
        all.plugins.push_back({discovery::GatewayId(id), std::move(plugin)});
    }
    return master::answer_of(all);
  }

  std::string worker_page(const nlohmann::json& given) {
    auto* const worker = cluster_.worker(master::text_of(given, "worker"));
    if (worker == nullptr) throw config::Error("no worker \"" + master::text_of(given, "worker") + "\"");
    const auto request = rpc::read_target(master::text_of(given, "target"));
    try {
      if (request.path == "/trace") return topology::trace_page(*worker, request.query);
      if (request.path == "/units") return topology::units_page(*worker);
      if (request.path == "/tap") return topology::tap_page(*worker, request.query);
    } catch (const std::invalid_argument& wrong) {
      throw config::Error(wrong.what());
    }
    throw config::Error("a worker's page " + request.path + " is not read here; there are /tap, /trace and /units");
  }

  LocalCluster& cluster_;
};

master::Live::Source source_of(LocalCluster& cluster) {
  master::Live::Source source;
  source.status = [&] { return cluster.master().status(); };
  source.drivers = [&] { return cluster.master().drivers(); };
  source.gateways = [&] { return cluster.master().gateways(); };
  source.topologies = [&] { return cluster.master().topologies(); };
  source.carried = [] {
    std::vector<master::CarriedByGateway> all;
    for (auto& messages : gateway::carried_messages(config::process_metrics().collect()))
      all.push_back({discovery::GatewayId(), std::move(messages)});  // those of this process count together
    return all;
  };
  source.worker_page = [&](const auto&, const std::string& name) {
    auto* const worker = cluster.worker(name);
    if (worker == nullptr) throw config::Error("it is in another process");
    return worker->describe();
  };
  return source;
}

master::Console::Options options_for(LocalCluster& cluster, const std::string& address,
                                     std::vector<std::string> pages) {
  if (!config::is_loopback(rpc::HttpAddress(address).host))
    throw config::Error("the console of one process is for this machine: an address on 127.0.0.1, not " + address);
  master::Console::Options options;
  options.settings.pages.address = address;
  options.settings.page_plugins.folders = std::move(pages);
  options.id = cluster.master().status().id;
  return options;
}

}  // namespace

struct LocalConsole::Impl {
  Impl(LocalCluster& cluster, const std::string& address, std::vector<std::string> pages)
      : calls(cluster), console(options_for(cluster, address, std::move(pages)), source_of(cluster), calls) {}
  RecentLines lines;
  LocalCalls calls;
  master::Console console;
};

LocalConsole::LocalConsole(LocalCluster& cluster, const std::string& address, std::vector<std::string> pages)
    : impl_(std::make_unique<Impl>(cluster, address, std::move(pages))) {}
LocalConsole::~LocalConsole() = default;

std::string LocalConsole::url() const {
  return impl_->console.url();
}

}  // namespace iotcloud::local
