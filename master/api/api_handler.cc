#include <algorithm>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/plugins/plugin_uploads.h>

namespace iotcloud::master {

using discovery::wire::TResponse;
using discovery::wire::TSensor;
using discovery::wire::TSensorDeployDescriptor;
using discovery::wire::TSite;
using discovery::wire::TSiteDetailsResponse;

namespace {

/// For the audit log.
std::string words(const std::vector<std::string>& items, const char* when_empty) {
  constexpr std::size_t shown = 20;
  if (items.empty()) return when_empty;
  const auto end = items.begin() + static_cast<std::ptrdiff_t>(std::min(shown, items.size()));
  return fmt::format("{}{}", fmt::join(items.begin(), end, ","),
                     items.size() > shown ? fmt::format(" and {} more", items.size() - shown) : "");
}
std::string words(const InstanceSelection& selection) {
  return fmt::format("{} on {}", words(selection.instances, "none"), words(selection.gateways, "any"));
}
std::string words(const DeployRequest& request) {
  return fmt::format("{} of {} on {}", request.count, request.plugin, words(request.gateways, "all"));
}
/// Properties may hold secrets: how many, not which.
std::string words(const wire::TDeploymentChange& change) {
  return fmt::format("{}{}{}", words(change.instances, "none"),
                     change.__isset.properties ? fmt::format(": {} properties", change.properties.size()) : "",
                     change.__isset.manager ? fmt::format(", of \"{}\"", change.manager) : "");
}
std::string words(const wire::TPluginOffer& offer, const std::vector<std::string>& gateways) {
  return fmt::format("{}, SHA-256 {}, to {}", offer.plugin, offer.sha256, words(gateways, "all"));
}
std::string words(const wire::TUpdateRequest& request) {
  const auto update = from_wire(request);
  return fmt::format("{} to {}{}", words(update.selection), update.plugin,
                     update.sha256.empty() ? "" : ", SHA-256 " + update.sha256);
}
std::string words(const wire::TTopologyRequest& request) {
  const auto name = wire::_TTopologyChange_VALUES_TO_NAMES.find(request.change);
  return fmt::format("{} {}", name == wire::_TTopologyChange_VALUES_TO_NAMES.end() ? "?" : name->second,
                     request.topology);
}

wire::TDriverChange wire_change(const DriverChange& change) {
  wire::TDriverChange told;
  told.__set_gateway(change.gateway);
  told.__set_instance(change.instance);
  told.__set_driver(change.driver);
  told.__set_state(change.state);
  told.__set_reason(change.reason);
  told.__set_timeMs(change.time_ms);
  return told;
}

/// One connection.
class ApiHandler final : public wire::TMasterAPIServiceIf {
 public:
  ApiHandler(Master& master, PluginUploads& uploads, const GatewayAccess& gateways,
             std::shared_ptr<config::Session> session)
      : master_(master), uploads_(uploads), gateways_(gateways), session_(std::move(session)) {}

  // ---- of the original

  void getSites(std::vector<std::string>& ids) override {
    for (const auto& gateway : master_.gateways()) ids.push_back(gateway.record.id);
  }

  void getSite(TSiteDetailsResponse& answer, const std::string& id) override {
    try {
      for (const auto& gateway : master_.gateways()) {
        if (gateway.record.id != id) continue;
        answer.__set_details(to_wire(gateway));
        answer.state = success();
        return;
      }
      answer.state = failure(fmt::format("no gateway \"{}\"", id));
    } catch (const config::Error& e) {
      answer.state = failure(e.what());
    }
  }

  void deploySensor(TResponse& response, const std::vector<std::string>& sites,
                    const TSensorDeployDescriptor& descriptor) override {
    DeployRequest request;
    request.gateways = sites;
    request.plugin = descriptor.filename;
    // "cgl.iotcloud.turtle.TurtleSensor" names a class of the original; ours are named by their plugin.
    if (descriptor.className.find('.') == std::string::npos) request.driver = descriptor.className;
    request.properties = descriptor.properties;
    respond(response, words(request), [&] { return master_.deploy(request); });
  }

  void unDeploySensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{id}, sites, {}};
    respond(response, words(selection), [&] { return master_.undeploy(selection); });
  }
  void unDeployAllSensor(TResponse& response, const std::string& id) override { unDeploySensor(response, {}, id); }
  void startSensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{id}, sites, {}};
    respond(response, words(selection), [&] { return master_.start(selection); });
  }
  void startAllSensor(TResponse& response, const std::string& id) override { startSensor(response, {}, id); }
  void stopSiteSensors(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{id}, sites, {}};
    respond(response, words(selection), [&] { return master_.stop(selection); });
  }
  void stopAllSensors(TResponse& response, const std::string& id) override { stopSiteSensors(response, {}, id); }

  void getSensors(std::vector<TSensor>& sensors, const std::string& site) override {
    for (const auto& driver : master_.drivers())
      if (driver.gateway == site) sensors.push_back(to_wire(driver));
  }
  void getAllSensors(std::vector<TSensor>& sensors) override {
    for (const auto& driver : master_.drivers()) sensors.push_back(to_wire(driver));
  }

  // ---- new

  void authenticate(TResponse& response, const std::string& token) override {
    const std::string problem = session_->authenticate(token);
    response = problem.empty() ? success() : failure(problem);
  }

  void getStatus(wire::TMasterStatus& out) override {
    read([&] {
      const auto status = master_.status();
      out.__set_id(status.id);
      out.__set_leading(status.leading);
      out.__set_epoch(status.epoch);
      out.__set_leader(status.leader);
      out.__set_registryAway(status.registry_away);
    });
  }
  void listGateways(std::vector<TSite>& out) override {
    read([&] {
      for (const auto& gateway : master_.gateways()) out.push_back(to_wire(gateway));
    });
  }
  void listDrivers(std::vector<TSensor>& out) override {
    read([&] {
      const auto drivers = master_.drivers();
      out.reserve(drivers.size());
      for (const auto& driver : drivers) out.push_back(to_wire(driver));
    });
  }
  void listTopologies(std::vector<wire::TTopology>& out) override {
    read([&] {
      for (const auto& topology : master_.topologies()) out.push_back(to_wire(topology));
    });
  }

  void getHistory(wire::TDriverHistory& out, const std::vector<std::string>& instances,
                  const std::vector<std::string>& gateways, std::int32_t most) override {
    read([&] {
      auto history = read_history(master_, gateways_, instances, gateways, most);
      for (auto& change : history.changes) out.changes.push_back(wire_change(change));
      out.__set_silent(std::move(history.silent));
    });
  }
  void readLog(wire::TLogPart& out, const std::string& gateway, const std::string& instance,
               const std::string& position, std::int32_t most_bytes) override {
    read([&] {
      auto part = read_log(master_, gateways_, gateway, instance, position, most_bytes);
      out.__set_text(std::move(part.text));
      out.__set_position(std::move(part.position));
    });
  }

  void deploy(wire::TOrderResponse& out, const wire::TDeployRequest& request) override {
    const auto deployment = from_wire(request);
    order(out, words(deployment), [&] { return master_.deploy(deployment); });
  }
  void undeploy(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, words(from_wire(selection)), [&] { return master_.undeploy(from_wire(selection)); });
  }
  void start(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, words(from_wire(selection)), [&] { return master_.start(from_wire(selection)); });
  }
  void stop(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, words(from_wire(selection)), [&] { return master_.stop(from_wire(selection)); });
  }
  void updateMetadata(wire::TOrderResponse& out, const wire::TInstanceSelection& selection,
                      const std::map<std::string, std::string>& changes) override {
    order(out, words(from_wire(selection)), [&] { return master_.update_metadata(from_wire(selection), changes); });
  }
  void changeDeployment(wire::TOrderResponse& out, const wire::TDeploymentChange& change) override {
    order(out, words(change), [&] { return master_.change_deployment(from_wire(change)); });
  }
  void listOrders(std::vector<wire::TOrder>& out) override {
    read([&] {
      const bool with_secrets = session_->role() == config::Role::admin;
      for (const auto& placed : master_.orders()) out.push_back(to_wire(placed, with_secrets));
    });
  }
  void drain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order(out, words(selection.gateways, "none"), [&] { return master_.drain(from_wire(selection)); });
  }
  void undrain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order(out, words(selection.gateways, "none"), [&] { return master_.undrain(from_wire(selection)); });
  }
  void offerPlugin(wire::TUploadResponse& out, const wire::TPluginOffer& offer,
                   const std::vector<std::string>& gateways) override {
    order(out, words(offer, gateways), [&] { return uploads_.offer(from_wire(offer), gateways); });
  }
  void sendPlugin(wire::TUploadResponse& out, const std::string& upload, std::int64_t offset,
                  const std::string& bytes) override {
    order(out, upload, [&] { return uploads_.send(upload, offset, bytes); });
  }
  void finishPlugin(wire::TUploadResponse& out, const std::string& upload) override {
    order(out, upload, [&] { return uploads_.finish(upload); });
  }
  void update(wire::TOrderResponse& out, const wire::TUpdateRequest& request) override {
    order(out, words(request), [&] { return master_.update(from_wire(request)); });
  }
  void orderTopology(wire::TTopologyResponse& out, const wire::TTopologyRequest& request) override {
    order(out, words(request), [&] { return master_.order(from_wire(request)); });
  }

 private:
  template <typename Body>
  static void read(Body&& body) {
    try {
      body();
    } catch (const config::Error& e) {
      wire::TMasterError error;
      error.reason = e.what();
      throw error;
    }
  }

  template <typename Body>
  void respond(TResponse& response, std::string what, Body&& body) {
    response = to_response(tell(std::move(what), body));
  }

  template <typename Response, typename Body>
  void order(Response& out, std::string what, Body&& body) {
    out = to_wire(tell(std::move(what), body));
  }

  /// Notes what becomes of an order, for the audit log.
  template <typename Body>
  auto tell(std::string what, Body&& body) {
    try {
      auto result = body();
      session_->note(std::move(what), result.summary());
      return result;
    } catch (const std::exception& e) {
      session_->note(std::move(what), e.what());
      throw;
    }
  }

  Master& master_;
  PluginUploads& uploads_;
  const GatewayAccess& gateways_;
  const std::shared_ptr<config::Session> session_;
};

/// What all connections share.
struct Shared {
  Shared(Master& served, GatewayAccess access_to_gateways, const PluginUploads::Options& passed_on)
      : master(served), gateways(std::move(access_to_gateways)), uploads(served, gateways, passed_on) {}
  Master& master;
  const GatewayAccess gateways;
  PluginUploads uploads;
  config::AccessOptions access;
};

}  // namespace

config::ThriftService serve_api(Master& master, ApiAccess access) {
  auto shared = std::make_shared<Shared>(master, std::move(access.gateways), access.uploads);
  shared->access.service = "api";
  shared->access.rules = api_rules();
  shared->access.tokens = std::move(access.tokens);
  shared->access.audit = std::move(access.audit);
  shared->access.not_authenticated = wire::TRefusal::NOT_AUTHENTICATED;
  shared->access.not_allowed = wire::TRefusal::NOT_ALLOWED;
  shared->access.wrong_token_pause = access.wrong_token_pause;
  // The server's options keep this function, and so what is shared, for as long as there are connections.
  return [shared](const std::shared_ptr<config::ThriftPeer>& peer) {
    auto session = std::make_shared<config::Session>(shared->access, peer);
    return config::guarded(std::make_shared<wire::TMasterAPIServiceProcessor>(std::make_shared<ApiHandler>(
                               shared->master, shared->uploads, shared->gateways, session)),
                           session);
  };
}

}  // namespace iotcloud::master
