#include <utility>

#include <fmt/format.h>

#include "iotcloud/master/TMasterService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/originals/gateway_handler.h>
#include <iotcloud/master/originals/original_gateways.h>

namespace iotcloud::master {

using discovery::wire::TResponse;
using discovery::wire::TSensor;
using discovery::wire::TSite;

namespace {

/// What all connections share.
struct OriginalPort {
  OriginalGateways& gateways;
  const std::function<MasterStatus()> status;
  rpc::AccessOptions access;
};

/// All that it takes is an order about the fleet's records.
const rpc::MethodRules& original_rules() {
  constexpr rpc::MethodRule order{security::Role::admin, rpc::RefusalForm::response};
  static const rpc::MethodRules rules{{"registerSite", order},
                                      {"unRegisterSite", order},
                                      {"registerSensor", order},
                                      {"unRegisterSensor", order},
                                      {"updateSensor", order}};
  return rules;
}

class GatewayHandler final : public wire::TMasterServiceIf {
 public:
  GatewayHandler(OriginalPort& port, std::shared_ptr<rpc::CallerSession> session)
      : gateways_(port.gateways), status_(port.status), session_(std::move(session)) {}

  void registerSite(TResponse& response, const TSite& site) override {
    respond(response, fmt::format("{} at {}:{}", site.siteId, site.host, site.port),
            [&] { return gateways_.register_gateway(discovery::as_own<discovery::GatewayRecord>(site)); });
  }
  void unRegisterSite(TResponse& response, const TSite& site) override {
    respond(response, site.siteId, [&] { return gateways_.unregister_gateway(discovery::GatewayId(site.siteId)); });
  }
  void registerSensor(TResponse& response, const std::string& site, const TSensor& sensor) override {
    respond(response, fmt::format("{} ({}) of {}", sensor.sensorId, sensor.name, site), [&] {
      return gateways_.put_driver(discovery::GatewayId(site), discovery::from_wire(sensor, "registerSensor"));
    });
  }
  void unRegisterSensor(TResponse& response, const std::string& site, const std::string& id) override {
    respond(response, fmt::format("{} of {}", id, site),
            [&] { return gateways_.remove_driver(discovery::GatewayId(site), discovery::InstanceId(id)); });
  }
  void updateSensor(TResponse& response, const std::string& site, const TSensor& sensor) override {
    registerSensor(response, site, sensor);
  }

 private:
  /// \param what for the audit log, which is told before and after
  template <typename Body>
  void respond(TResponse& response, std::string what, Body&& body) {
    std::string problem;
    try {
      session_->begins(std::move(what));
      const auto status = status_();
      problem = status.leading ? body()
                               : fmt::format("master {} does not lead; {}", status.id,
                                             status.leader.empty() ? "none does yet" : status.leader + " does");
    } catch (const config::Error& e) {  // the arguments are no valid record, or nothing can be written down
      problem = e.what();
    }
    session_->note(problem.empty() ? "done" : problem);
    response = problem.empty() ? success() : failure(problem);
  }

  OriginalGateways& gateways_;
  const std::function<MasterStatus()>& status_;
  const std::shared_ptr<rpc::CallerSession> session_;
};

}  // namespace

rpc::ThriftService serve_original_gateways(OriginalGateways& gateways, std::function<MasterStatus()> status,
                                           OriginalAccess access) {
  auto port = std::make_shared<OriginalPort>(OriginalPort{gateways, std::move(status), {}});
  port->access.service = "gateways";
  port->access.rules = original_rules();
  port->access.users = std::move(access.users);
  port->access.open = access.open;
  port->access.audit = std::move(access.audit);
  port->access.limits = std::make_shared<rpc::RoleLimits>(access.calls);
  return [port](const std::shared_ptr<rpc::ThriftPeer>& peer) {
    auto session = std::make_shared<rpc::CallerSession>(port->access, peer);
    auto handler = std::make_shared<GatewayHandler>(*port, session);
    return rpc::guarded(std::make_shared<wire::TMasterServiceProcessor>(std::move(handler)), session);
  };
}

}  // namespace iotcloud::master
