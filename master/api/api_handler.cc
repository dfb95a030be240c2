#include <algorithm>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/api/pool_pages.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/gateways/plugin_uploads.h>
#include <iotcloud/master/master.h>

namespace iotcloud::master {

using discovery::GatewayId;
using discovery::InstanceId;
using discovery::wire::TResponse;
using discovery::wire::TSensor;
using discovery::wire::TSensorDeployDescriptor;
using discovery::wire::TSite;
using discovery::wire::TSiteDetailsResponse;

namespace {

std::vector<GatewayId> gateway_ids(const std::vector<std::string>& texts) {
  return {texts.begin(), texts.end()};
}
std::string words(const PluginOffer& offer, const std::vector<GatewayId>& gateways) {
  return fmt::format("{}, SHA-256 {}, to {}", offer.plugin, offer.sha256, master::words(gateways, "all"));
}
std::string words(const TopologyRequest& request) {
  const auto name = wire::_TTopologyChange_VALUES_TO_NAMES.find(static_cast<int>(request.change));
  return fmt::format("{} {}", name == wire::_TTopologyChange_VALUES_TO_NAMES.end() ? "?" : name->second,
                     request.topology);
}

/// The handler of one connection.
class ApiHandler final : public wire::TMasterAPIServiceIf {
 public:
  ApiHandler(Master& master, PluginUploads& uploads, const GatewayAccess& gateways, const WorkerAccess& workers,
             const PoolAccess& pools, GatewayAsks& asks, std::shared_ptr<rpc::CallerSession> session)
      : master_(master),
        uploads_(uploads),
        gateways_(gateways),
        workers_(workers),
        pools_(pools),
        asks_(asks),
        session_(std::move(session)) {}

  // ---- of the original

  void getSites(std::vector<std::string>& ids) override {
    for (const auto& gateway : master_.gateways()) ids.push_back(gateway.record.id);
  }

  void getSite(TSiteDetailsResponse& answer, const std::string& id) override {
    try {
      for (const auto& gateway : master_.gateways()) {
        if (gateway.record.id != id) continue;
        answer.__set_details(discovery::as_wire<TSite>(gateway));
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
    request.gateways = gateway_ids(sites);
    request.plugin = descriptor.filename;
    // "cgl.iotcloud.turtle.TurtleSensor" names a class of the original; ours are named by their plugin.
    if (descriptor.className.find('.') == std::string::npos)
      request.driver = discovery::DriverName(descriptor.className);
    request.properties = descriptor.properties;
    respond(response, words(request), [&] { return master_.deploy(request); });
  }

  void unDeploySensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{InstanceId(id)}, gateway_ids(sites), {}};
    respond(response, words(selection), [&] { return master_.undeploy(selection); });
  }
  void unDeployAllSensor(TResponse& response, const std::string& id) override { unDeploySensor(response, {}, id); }
  void startSensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{InstanceId(id)}, gateway_ids(sites), {}};
    respond(response, words(selection), [&] { return master_.start(selection); });
  }
  void startAllSensor(TResponse& response, const std::string& id) override { startSensor(response, {}, id); }
  void stopSiteSensors(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    const InstanceSelection selection{{InstanceId(id)}, gateway_ids(sites), {}};
    respond(response, words(selection), [&] { return master_.stop(selection); });
  }
  void stopAllSensors(TResponse& response, const std::string& id) override { stopSiteSensors(response, {}, id); }

  void getSensors(std::vector<TSensor>& sensors, const std::string& site) override {
    for (const auto& driver : master_.drivers())
      if (driver.gateway == site) sensors.push_back(without_secrets(driver));
  }
  void getAllSensors(std::vector<TSensor>& sensors) override {
    for (const auto& driver : master_.drivers()) sensors.push_back(without_secrets(driver));
  }

  // ---- new

  void authenticate(TResponse& response, const std::string& token) override {
    const std::string problem = session_->authenticate(token);
    response = problem.empty() ? success() : failure(problem);
  }

  void getStatus(wire::TMasterStatus& out) override {
    read([&] { discovery::fill_wire(master_.status(), out); });
  }
  void listGateways(std::vector<TSite>& out) override {
    read([&] {
      for (const auto& gateway : master_.gateways()) discovery::fill_wire(gateway, out.emplace_back());
    });
  }
  void listDrivers(std::vector<TSensor>& out) override {
    read([&] {
      const auto drivers = master_.drivers_and_lost_orders();
      out.reserve(drivers.size());
      for (const auto& driver : drivers) out.push_back(without_secrets(driver));
    });
  }
  void listTopologies(std::vector<wire::TTopology>& out) override {
    read([&] {
      for (const auto& topology : master_.topologies()) discovery::fill_wire(topology, out.emplace_back());
    });
  }

  void listPools(std::vector<wire::TPool>& out) override {
    read([&] {
      for (const auto& pool : master_.pools()) discovery::fill_wire(pool, out.emplace_back());
    });
  }

  void getHistory(wire::TDriverHistory& out, const std::vector<std::string>& instances,
                  const std::vector<std::string>& gateways, std::int32_t most) override {
    read([&] {
      discovery::fill_wire(read_history(master_, gateways_, asks_, instances, gateway_ids(gateways), most), out);
    });
  }
  void readLog(wire::TLogPart& out, const std::string& gateway, const std::string& instance,
               const std::string& position, std::int32_t most_bytes) override {
    read([&] {
      discovery::fill_wire(read_log(master_, gateways_, GatewayId(gateway), InstanceId(instance), position, most_bytes),
                           out);
    });
  }

  void listPlugins(wire::TGatewayPlugins& out, const std::vector<std::string>& gateways) override {
    read([&] { discovery::fill_wire(read_plugins(master_, gateways_, asks_, gateway_ids(gateways)), out); });
  }

  void getTopologyHistory(std::vector<wire::TTopologyEvent>& out, const std::string& topology) override {
    read([&] {
      for (const auto& event : master_.history(discovery::TopologyName(topology)).events)
        discovery::fill_wire(event, out.emplace_back());
    });
  }
  void readWorkerLog(wire::TLogPart& out, const std::string& topology, std::int32_t place, const std::string& position,
                     std::int32_t most_bytes) override {
    read([&] {
      discovery::fill_wire(
          read_worker_log(master_, pools_, {discovery::TopologyName(topology), place}, position, most_bytes), out);
    });
  }

  void readWorkerPage(std::string& out, const std::string& topology, const std::string& worker,
                      const std::string& target) override {
    read([&] { out = read_worker_page(master_, workers_, discovery::TopologyName(topology), worker, target); });
  }

  void lookAtChannel(discovery::wire::TChannelLook& out, const std::string& gateway,
                     const discovery::wire::TLookRequest& request) override {
    read([&] {
      const auto asked = discovery::as_own<discovery::LookRequest>(request);
      discovery::fill_wire(look_at_channel(master_, gateways_, GatewayId(gateway), asked), out);
    });
  }
  void handMessage(discovery::wire::TChannelLook& out, const std::string& gateway,
                   const discovery::wire::THandedMessage& message) override {
    read([&] {
      const auto handed = discovery::as_own<discovery::HandedMessage>(message);
      session_->begins(
          fmt::format("{} bytes for channel {} of {}", handed.payload.size(), handed.channel, handed.instance));
      try {
        const auto look = hand_message(master_, gateways_, GatewayId(gateway), handed);
        session_->note(look.problem.empty() ? "done" : look.problem);
        discovery::fill_wire(look, out);
      } catch (const std::exception& e) {
        session_->note(e.what());
        throw;
      }
    });
  }

  void deploy(wire::TOrderResponse& out, const wire::TDeployRequest& request) override {
    order<DeployRequest>(out, request, &Master::deploy);
  }
  void undeploy(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order<InstanceSelection>(out, selection, &Master::undeploy);
  }
  void start(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order<InstanceSelection>(out, selection, &Master::start);
  }
  void stop(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order<InstanceSelection>(out, selection, &Master::stop);
  }
  void updateMetadata(wire::TOrderResponse& out, const wire::TInstanceSelection& selection,
                      const std::map<std::string, std::string>& changes) override {
    order<InstanceSelection>(out, selection, &Master::update_metadata, changes);
  }
  void changeDeployment(wire::TOrderResponse& out, const wire::TDeploymentChange& change) override {
    order<DeploymentChange>(out, change, &Master::change_deployment);
  }
  void listOrders(std::vector<wire::TOrder>& out) override {
    read([&] {
      const bool with_secrets = session_->role() == security::Role::admin;
      for (auto& placed : master_.orders())
        discovery::fill_wire(listed(std::move(placed), with_secrets), out.emplace_back());
    });
  }
  void exportOrders(std::string& out) override {
    read([&] {
      session_->begins("all orders");
      try {
        const auto backup = master_.backup();
        session_->note(words(backup));
        out = encode(backup);
      } catch (const std::exception& e) {
        session_->note(e.what());
        throw;
      }
    });
  }
  void drain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order<GatewaySelection>(out, selection, &Master::drain);
  }
  void undrain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order<GatewaySelection>(out, selection, &Master::undrain);
  }
  void update(wire::TOrderResponse& out, const wire::TUpdateRequest& request) override {
    order<UpdateRequest>(out, request, &Master::update);
  }
  void giveOrder(wire::TOrderResponse& out, const std::string& name, const std::string& json) override {
    if (const auto refusal = session_->refuse(name)) {
      out.__set_response(failure(refusal->text));
      out.__set_refusal(
          static_cast<wire::TRefusal::type>(refusal->unknown ? wire::TRefusal::BAD_REQUEST : refusal->code));
      return;
    }
    const auto given =
        master_.give(name, json, [&](const std::string& what) { session_->begins(fmt::format("{} {}", name, what)); });
    session_->note(given.result.summary());
    out = to_wire(given.result);
  }
  void orderTopology(wire::TTopologyResponse& out, const wire::TTopologyRequest& request) override {
    order<TopologyRequest>(out, request, &Master::order);
  }
  void offerPlugin(wire::TUploadResponse& out, const wire::TPluginOffer& wanted,
                   const std::vector<std::string>& gateways) override {
    const auto offer = discovery::as_own<PluginOffer>(wanted);
    const auto receivers = gateway_ids(gateways);
    pass_on(out, words(offer, receivers), [&] { return uploads_.offer(offer, receivers); });
  }
  void offerLibrary(wire::TUploadResponse& out, const wire::TPluginOffer& wanted) override {
    const auto offer = discovery::as_own<PluginOffer>(wanted);
    pass_on(out, fmt::format("{}, SHA-256 {}, to all pools", offer.plugin, offer.sha256),
            [&] { return uploads_.offer_library(offer); });
  }
  void sendPlugin(wire::TUploadResponse& out, const std::string& upload, std::int64_t offset,
                  const std::string& bytes) override {
    pass_on(out, upload, [&] { return uploads_.send(upload, offset, bytes); });
  }
  void finishPlugin(wire::TUploadResponse& out, const std::string& upload) override {
    pass_on(out, upload, [&] { return uploads_.finish(upload); });
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

  /// Converts an order from its Thrift struct, and gives it to the master.
  template <typename Order, typename Response, typename Wire, typename Give, typename... Arguments>
  void order(Response& out, const Wire& given, Give give, const Arguments&... arguments) {
    const auto order = discovery::as_own<Order>(given);
    Master& master = master_;  // GCC 12's -fsanitize=vptr mistakes the closure for `this` in (master_.*give)(...)
    out = to_wire(tell(words(order), [&] { return (master.*give)(order, arguments...); }));
  }

  template <typename Body>
  void pass_on(wire::TUploadResponse& out, std::string what, Body&& body) {
    out = to_wire(tell(std::move(what), body));
  }

  /// Tells the audit log of an order, before and after it is carried out.
  template <typename Body>
  auto tell(std::string what, Body&& body) {
    try {
      session_->begins(std::move(what));
      auto result = body();
      session_->note(result.summary());
      return result;
    } catch (const std::exception& e) {
      session_->note(e.what());
      throw;
    }
  }

  Master& master_;
  PluginUploads& uploads_;
  const GatewayAccess& gateways_;
  const WorkerAccess& workers_;
  const PoolAccess& pools_;
  GatewayAsks& asks_;
  const std::shared_ptr<rpc::CallerSession> session_;
};

/// What all connections share.
struct Shared {
  Shared(Master& served, GatewayAccess access_to_gateways, WorkerAccess access_to_workers, PoolAccess access_to_pools,
         const PluginUploads::Options& passed_on)
      : master(served),
        gateways(std::move(access_to_gateways)),
        workers(std::move(access_to_workers)),
        pools(std::move(access_to_pools)),
        uploads(served, gateways, pools, passed_on) {}
  Master& master;
  const GatewayAccess gateways;
  const WorkerAccess workers;
  const PoolAccess pools;
  PluginUploads uploads;
  GatewayAsks asks;
  rpc::AccessOptions access;
};

}  // namespace

rpc::ThriftService serve_api(Master& master, ApiAccess access) {
  auto shared = std::make_shared<Shared>(master, std::move(access.gateways), std::move(access.workers),
                                         std::move(access.pools), access.uploads);
  shared->access.service = "api";
  shared->access.rules = api_rules();
  shared->access.tokens = std::move(access.tokens);
  shared->access.users = std::move(access.users);
  shared->access.open = access.open;
  shared->access.audit = std::move(access.audit);
  shared->access.not_authenticated = wire::TRefusal::NOT_AUTHENTICATED;
  shared->access.not_allowed = wire::TRefusal::NOT_ALLOWED;
  shared->access.wrong_token_pause = access.wrong_token_pause;
  shared->access.limits = std::make_shared<rpc::RoleLimits>(access.calls);
  if (access.token_tries) shared->access.token_tries = std::move(access.token_tries);
  // The server's options keep this function, and with it `shared`, for as long as there are connections.
  return [shared](const std::shared_ptr<rpc::ThriftPeer>& peer) {
    auto session = std::make_shared<rpc::CallerSession>(shared->access, peer);
    auto handler = std::make_shared<ApiHandler>(shared->master, shared->uploads, shared->gateways, shared->workers,
                                                shared->pools, shared->asks, session);
    return rpc::guarded(std::make_shared<wire::TMasterAPIServiceProcessor>(std::move(handler)), session);
  };
}

}  // namespace iotcloud::master
