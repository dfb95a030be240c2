// What anybody may send to the master's API: a master on an embedded registry, whose gateways are lost, so that no
// order is waited for. One of them takes the plugins that are sent: it is there while one is offered. The ids of
// uploads are 0, 1,
// ... in each input, so that an input can come to the end of one.
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
#include "iotcloud/tests/fuzz/thrift_frames.h"
#include "iotcloud/tests/fuzz/whole_uploads.h"

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

fuzz::Tally& tally() {
  static fuzz::Tally all;
  return all;
}

/// A gateway that takes every plugin.
class Receiver final : public gateway::wire::TSensorSiteServiceNull {
 public:
  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway("lab2"); }
  void offerPlugin(std::string& upload, const gateway::wire::TPluginOffer&) override { upload = "u"; }
  void finishPlugin(const std::string&) override { ++tally().whole; }
};

/// The gateway at that path is there while a plugin is offered.
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

class Fleet {
 public:
  Fleet() {
    const discovery::Paths paths;
    discovery::GatewayRecord gateway;
    gateway.id = "lab1";
    gateway.host = "127.0.0.1";
    discovery::put(*registry_, paths.gateway("lab1"), encode(gateway));
    gateway.id = "lab2";
    gateway.port = receiver_.port();
    discovery::put(*registry_, paths.gateway("lab2"), encode(gateway));
    discovery::OrderRecord order;
    order.instance = "0a1b";
    order.plugin = "turtle.so";
    order.name = "robot";
    order.index = 1;
    discovery::put(*registry_, paths.order("lab1", "0a1b"), encode(order));
    discovery::DriverRecord driver;
    driver.name = "turtle";
    driver.instance = "0a1b";
    driver.gateway = "lab1";
    discovery::put(*registry_, paths.instance("turtle", "0a1b"), encode(driver));
    discovery::TopologyRecord topology;
    topology.name = "echo";
    discovery::put(*registry_, paths.topology("echo"), encode(topology));
    master::MasterOptions options;
    options.outcome_timeout = std::chrono::milliseconds(1);
    master_.emplace(*registry_, options);
    while (!master_->status().leading) std::this_thread::yield();
    master::ApiAccess access;
    access.uploads.clock = &clock_;
    access.uploads.new_upload_id = [this] { return std::to_string(uploads_++); };
    longest_kept_ = access.uploads.idle_limit;
    service_ = [this, api = master::serve_api(*master_, access),
                path = paths.gateway_alive("lab2")](const std::shared_ptr<config::ThriftPeer>& peer) {
      return std::make_shared<PresentForOffers>(api(peer), *registry_, path);
    };
  }

  const config::ThriftService& service() const { return service_; }
  /// Nothing of an input's uploads is there for the next one.
  void forget_plugins() {
    uploads_ = 0;
    clock_.move(longest_kept_);
  }
  /// Orders stay in the registry: so many that it is time for another one.
  bool is_full() { return registry_->children(discovery::Paths().orders("lab1")).value_or(Names{}).size() > 20'000; }

 private:
  using Names = std::vector<std::string>;
  fuzz::InputClock clock_;
  std::chrono::milliseconds longest_kept_{0};
  int uploads_ = 0;
  config::ThriftServer receiver_{{},
                                 [site = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(
                                      std::make_shared<Receiver>())](const auto&) { return site; }};
  std::unique_ptr<discovery::Registry> registry_ = fresh_registry();
  std::optional<master::Master> master_;
  config::ThriftService service_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  config::set_log_level(config::LogLevel::off);
  tally();  // dies after the fleet
  static auto fleet = std::make_unique<Fleet>();
  fuzz::serve(fleet->service(), data, size, {});
  fleet->forget_plugins();
  if (fleet->is_full()) {
    fleet.reset();
    fleet = std::make_unique<Fleet>();
  }
  return 0;
}
