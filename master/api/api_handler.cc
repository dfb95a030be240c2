#include <algorithm>
#include <functional>
#include <stdexcept>

#include <fmt/format.h>
#include <thrift/TApplicationException.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/plugins/plugin_uploads.h>

namespace iotcloud::master {

using apache::thrift::TApplicationException;
using discovery::wire::TResponse;
using discovery::wire::TSensor;
using discovery::wire::TSensorDeployDescriptor;
using discovery::wire::TSite;
using discovery::wire::TSiteDetailsResponse;

namespace {

constexpr const char* closed_text = "this master asks for a token: call authenticate(token) first on this connection";

/// Takes the same time wherever two strings of one length differ.
bool same_token(const std::string& a, const std::string& b) {
  if (a.size() != b.size()) return false;
  unsigned different = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    different |= static_cast<unsigned char>(a[i]) ^ static_cast<unsigned char>(b[i]);
  return different == 0;
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
  ApiHandler(Master& master, PluginUploads& uploads, const std::string& token)
      : master_(master), uploads_(uploads), token_(token), open_(token.empty()) {}

  // ---- of the original

  void getSites(std::vector<std::string>& ids) override {
    read_original([&] {
      for (const auto& gateway : master_.gateways()) ids.push_back(gateway.record.id);
    });
  }

  void getSite(TSiteDetailsResponse& answer, const std::string& id) override {
    if (!open_) return void(answer.state = failure(closed_text));
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
    respond(response, [&] { return master_.deploy(request); });
  }

  void unDeploySensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    respond(response, [&] { return master_.undeploy({{id}, sites, {}}); });
  }
  void unDeployAllSensor(TResponse& response, const std::string& id) override { unDeploySensor(response, {}, id); }
  void startSensor(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    respond(response, [&] { return master_.start({{id}, sites, {}}); });
  }
  void startAllSensor(TResponse& response, const std::string& id) override { startSensor(response, {}, id); }
  void stopSiteSensors(TResponse& response, const std::vector<std::string>& sites, const std::string& id) override {
    respond(response, [&] { return master_.stop({{id}, sites, {}}); });
  }
  void stopAllSensors(TResponse& response, const std::string& id) override { stopSiteSensors(response, {}, id); }

  void getSensors(std::vector<TSensor>& sensors, const std::string& site) override {
    read_original([&] {
      for (const auto& driver : master_.drivers())
        if (driver.gateway == site) sensors.push_back(to_wire(driver));
    });
  }
  void getAllSensors(std::vector<TSensor>& sensors) override {
    read_original([&] {
      for (const auto& driver : master_.drivers()) sensors.push_back(to_wire(driver));
    });
  }

  // ---- new

  void authenticate(TResponse& response, const std::string& token) override {
    open_ = token_.empty() || same_token(token, token_);
    response = open_ ? success() : failure("that is not this master's token");
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
      auto history = read_history(master_, instances, gateways, most);
      for (auto& change : history.changes) out.changes.push_back(wire_change(change));
      out.__set_silent(std::move(history.silent));
    });
  }
  void readLog(wire::TLogPart& out, const std::string& gateway, const std::string& instance,
               const std::string& position, std::int32_t most_bytes) override {
    read([&] {
      auto part = read_log(master_, gateway, instance, position, most_bytes);
      out.__set_text(std::move(part.text));
      out.__set_position(std::move(part.position));
    });
  }

  void deploy(wire::TOrderResponse& out, const wire::TDeployRequest& request) override {
    order(out, [&] { return master_.deploy(from_wire(request)); });
  }
  void undeploy(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, [&] { return master_.undeploy(from_wire(selection)); });
  }
  void start(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, [&] { return master_.start(from_wire(selection)); });
  }
  void stop(wire::TOrderResponse& out, const wire::TInstanceSelection& selection) override {
    order(out, [&] { return master_.stop(from_wire(selection)); });
  }
  void updateMetadata(wire::TOrderResponse& out, const wire::TInstanceSelection& selection,
                      const std::map<std::string, std::string>& changes) override {
    order(out, [&] { return master_.update_metadata(from_wire(selection), changes); });
  }
  void changeDeployment(wire::TOrderResponse& out, const wire::TDeploymentChange& change) override {
    order(out, [&] { return master_.change_deployment(from_wire(change)); });
  }
  void listOrders(std::vector<wire::TOrder>& out) override {
    read([&] {
      for (const auto& placed : master_.orders()) out.push_back(to_wire(placed));
    });
  }
  void drain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order(out, [&] { return master_.drain(from_wire(selection)); });
  }
  void undrain(wire::TOrderResponse& out, const wire::TGatewaySelection& selection) override {
    order(out, [&] { return master_.undrain(from_wire(selection)); });
  }
  void offerPlugin(wire::TUploadResponse& out, const wire::TPluginOffer& offer,
                   const std::vector<std::string>& gateways) override {
    order(out, [&] { return uploads_.offer(from_wire(offer), gateways); });
  }
  void sendPlugin(wire::TUploadResponse& out, const std::string& upload, std::int64_t offset,
                  const std::string& bytes) override {
    order(out, [&] { return uploads_.send(upload, offset, bytes); });
  }
  void finishPlugin(wire::TUploadResponse& out, const std::string& upload) override {
    order(out, [&] { return uploads_.finish(upload); });
  }
  void update(wire::TOrderResponse& out, const wire::TUpdateRequest& request) override {
    order(out, [&] { return master_.update(from_wire(request)); });
  }
  void orderTopology(wire::TTopologyResponse& out, const wire::TTopologyRequest& request) override {
    order(out, [&] { return master_.order(from_wire(request)); });
  }

 private:
  /// The original's reads have no field for an error: the client gets a TApplicationException with the text.
  template <typename Body>
  void read_original(Body&& body) {
    if (!open_) throw TApplicationException(TApplicationException::INTERNAL_ERROR, closed_text);
    body();
  }

  template <typename Body>
  void read(Body&& body) {
    wire::TMasterError error;
    if (!open_) {
      error.reason = closed_text;
      throw error;
    }
    try {
      body();
    } catch (const config::Error& e) {
      error.reason = e.what();
      throw error;
    }
  }

  template <typename Body>
  void respond(TResponse& response, Body&& body) {
    response = open_ ? to_response(body()) : failure(closed_text);
  }

  template <typename Response, typename Body>
  void order(Response& out, Body&& body) {
    if (open_) {
      out = to_wire(body());
    } else {
      out.__set_response(failure(closed_text));
      out.__set_refusal(wire::TRefusal::NOT_AUTHENTICATED);
    }
  }

  Master& master_;
  PluginUploads& uploads_;
  const std::string& token_;
  bool open_;
};

class ApiHandlers final : public wire::TMasterAPIServiceIfFactory {
 public:
  ApiHandlers(Master& master, std::string token) : master_(master), uploads_(master), token_(std::move(token)) {}
  wire::TMasterAPIServiceIf* getHandler(const apache::thrift::TConnectionInfo&) override {
    return std::make_unique<ApiHandler>(master_, uploads_, token_).release();
  }
  void releaseHandler(wire::TMasterAPIServiceIf* handler) override {
    std::unique_ptr<wire::TMasterAPIServiceIf> owned(handler);
  }

 private:
  Master& master_;
  PluginUploads uploads_;
  const std::string token_;
};

}  // namespace

std::shared_ptr<apache::thrift::TProcessorFactory> serve_api(Master& master, std::string token) {
  return std::make_shared<wire::TMasterAPIServiceProcessorFactory>(
      std::make_shared<ApiHandlers>(master, std::move(token)));
}

}  // namespace iotcloud::master
