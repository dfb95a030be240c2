// Hostile calls of the master's API: a master on an embedded registry, whose gateways are lost, so that it waits for no
// order. One gateway takes plugins and is present while one is offered. The ids of uploads are 0, 1, ... in each input,
// so that an input can complete an upload.
#include <optional>
#include <thread>

#include <thrift/processor/TMultiplexedProcessor.h>

#include "iotcloud/config/log.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/registry.h"
#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/api/api_handler.h"
#include "iotcloud/master/master.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/tests/fuzz/thrift_frames.h"
#include "iotcloud/tests/fuzz/whole_uploads.h"
#include <iotcloud/tests/discovery/id_literals.h>

using namespace iotcloud;

namespace {

std::unique_ptr<discovery::Registry> fresh_registry() {
  static int number = 0;
  discovery::RegistryOptions options;
  options.url = "embedded://fuzz-master-" + std::to_string(number++);
  return discovery::make_registry(options);
}

using apache::thrift::TProcessor;
using apache::thrift::protocol::TProtocol;

fuzz::Tally& plugins_to_master() {
  static fuzz::Tally all;
  return all;
}

/// A gateway that takes every plugin.
class Receiver final : public gateway::wire::TSensorSiteServiceNull {
 public:
  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway("lab2"); }
  void offerPlugin(std::string& upload, const gateway::wire::TPluginOffer&) override { upload = "u"; }
  void finishPlugin(const std::string&) override { ++plugins_to_master().whole; }
};

/// The gateway at that path is present while a plugin is offered.
class PresentForOffers final : public TProcessor {
 public:
  PresentForOffers(std::shared_ptr<TProcessor> api, discovery::Registry& registry, std::string path)
      : api_(std::move(api)), registry_(registry), path_(std::move(path)) {}

  bool process(std::shared_ptr<TProtocol> in, std::shared_ptr<TProtocol> out, void* context) override {
    std::string method;
    apache::thrift::protocol::TMessageType type{};
    std::int32_t number = 0;
    in->readMessageBegin(method, type, number);
    discovery::GuardPtr there;
    if (method == "offerPlugin") there = registry_.hold(path_, "");
    return api_->process(std::make_shared<apache::thrift::protocol::StoredMessageProtocol>(in, method, type, number),
                         out, context);
  }

 private:
  const std::shared_ptr<TProcessor> api_;
  discovery::Registry& registry_;
  const std::string path_;
};

class MasterOfFleet {
 public:
  MasterOfFleet() {
    const discovery::Paths paths;
    discovery::GatewayRecord gateway;
    gateway.id = "lab1"_gateway;
    gateway.host = "127.0.0.1";
    discovery::put(*registry_, paths.gateway("lab1"_gateway), encode(gateway));
    gateway.id = "lab2"_gateway;
    gateway.port = receiver_.port();
    discovery::put(*registry_, paths.gateway("lab2"_gateway), encode(gateway));
    discovery::OrderRecord order;
    order.instance = "0a1b"_instance;
    order.plugin = "turtle.so";
    order.name = "robot";
    order.index = 1;
    discovery::put(*registry_, paths.order("lab1"_gateway, "0a1b"_instance), encode(order));
    discovery::DriverRecord driver;
    driver.name = "turtle"_driver;
    driver.instance = "0a1b"_instance;
    driver.gateway = "lab1"_gateway;
    discovery::put(*registry_, paths.instance("turtle"_driver, "0a1b"_instance), encode(driver));
    discovery::TopologyRecord topology;
    topology.name = "echo"_topology;
    discovery::put(*registry_, paths.topology("echo"_topology), encode(topology));
    master::MasterOptions options;
    options.outcome_timeout = std::chrono::milliseconds(1);
    master_.emplace(*registry_, options);
    while (!master_->status().leading) std::this_thread::yield();
    master::ApiAccess access;
    access.uploads.clock = &clock_;
    access.uploads.new_upload_id = [this] { return std::to_string(uploads_++); };
    longest_kept_ = access.uploads.idle_limit;
    service_ = [this, api = master::serve_api(*master_, access),
                path = paths.gateway_alive("lab2"_gateway)](const std::shared_ptr<rpc::ThriftPeer>& peer) {
      return std::make_shared<PresentForOffers>(api(peer), *registry_, path);
    };
  }

  const rpc::ThriftService& service() const { return service_; }
  /// Removes the uploads of an input before the next one.
  void forget_plugins() {
    uploads_ = 0;
    clock_.move(longest_kept_);
  }
  /// Orders stay in the registry; when there are too many it is time for a new one.
  bool is_full() {
    return registry_->children(discovery::Paths().orders("lab1"_gateway)).value_or(Names{}).size() > 20'000;
  }

 private:
  using Names = std::vector<std::string>;
  fuzz::InputClock clock_;
  std::chrono::milliseconds longest_kept_{0};
  int uploads_ = 0;
  rpc::ThriftServer receiver_{{},
                              [site = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(
                                   std::make_shared<Receiver>())](const auto&) { return site; }};
  std::unique_ptr<discovery::Registry> registry_ = fresh_registry();
  std::optional<master::Master> master_;
  rpc::ThriftService service_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(master_api, 1'000) {
  config::set_log_level(config::LogLevel::off);
  plugins_to_master();  // destroyed after the fleet
  static auto fleet = std::make_unique<MasterOfFleet>();
  fuzz::serve(fleet->service(), data, size, {});
  fleet->forget_plugins();
  if (fleet->is_full()) {
    fleet.reset();
    fleet = std::make_unique<MasterOfFleet>();
  }
}
