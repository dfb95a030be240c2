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

/// Has no state of a connection, so one handler serves all connections.
class GatewayHandler final : public wire::TMasterServiceIf {
 public:
  GatewayHandler(OriginalGateways& gateways, std::function<MasterStatus()> status)
      : gateways_(gateways), status_(std::move(status)) {}

  void registerSite(TResponse& response, const TSite& site) override {
    respond(response, [&] { return gateways_.register_gateway(discovery::as_own<discovery::GatewayRecord>(site)); });
  }
  void unRegisterSite(TResponse& response, const TSite& site) override {
    respond(response, [&] { return gateways_.unregister_gateway(discovery::GatewayId(site.siteId)); });
  }
  void registerSensor(TResponse& response, const std::string& site, const TSensor& sensor) override {
    respond(response, [&] {
      return gateways_.put_driver(discovery::GatewayId(site), discovery::from_wire(sensor, "registerSensor"));
    });
  }
  void unRegisterSensor(TResponse& response, const std::string& site, const std::string& id) override {
    respond(response, [&] { return gateways_.remove_driver(discovery::GatewayId(site), discovery::InstanceId(id)); });
  }
  void updateSensor(TResponse& response, const std::string& site, const TSensor& sensor) override {
    registerSensor(response, site, sensor);
  }

 private:
  template <typename Body>
  void respond(TResponse& response, Body&& body) {
    const auto status = status_();
    if (!status.leading) {
      response = failure(fmt::format("master {} does not lead; {}", status.id,
                                     status.leader.empty() ? "none does yet" : status.leader + " does"));
      return;
    }
    try {
      const std::string problem = body();
      response = problem.empty() ? success() : failure(problem);
    } catch (const config::Error& e) {  // the arguments are no valid record
      response = failure(e.what());
    }
  }

  OriginalGateways& gateways_;
  const std::function<MasterStatus()> status_;
};

}  // namespace

rpc::ThriftService serve_original_gateways(OriginalGateways& gateways, std::function<MasterStatus()> status) {
  const auto processor =
      std::make_shared<wire::TMasterServiceProcessor>(std::make_shared<GatewayHandler>(gateways, std::move(status)));
  return [processor](const auto&) { return processor; };
}

}  // namespace iotcloud::master
