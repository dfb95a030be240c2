#include <fstream>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/thrift_server.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/master_service.h>
#include <iotcloud/master/originals/gateway_handler.h>
#include <iotcloud/master/originals/original_gateways.h>

namespace iotcloud::master {

using std::chrono::milliseconds;

namespace {

constexpr config::Logger logger{"master"};
/// Less than a daemon may take to stop: a call that waits for an absent registry must not hold that up.
constexpr milliseconds registry_timeout{3'000};

/// Orders come in here, so only this machine may reach it: on a wire they would need TLS and a token.
void read_address(config::Section& section, ListenAddress& address) {
  address.host = section.string_or("host", address.host);
  address.port = static_cast<int>(section.int_or("port", address.port, 1, 65535));
  if (is_loopback(address.host)) return;
  throw section.error("host",
                      fmt::format("{} can be reached from other machines, and this master speaks no TLS: "
                                  "anybody there could give orders",
                                  address.host),
                      "127.0.0.1; from elsewhere use a tunnel, for example ssh -L 12904:127.0.0.1:12904 HOST");
}

std::string first_line(const config::Section& section, const std::string& key, const std::string& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line) || line.empty())
    throw section.error(key, fmt::format("cannot read a token from {}", file),
                        "a file that the master may read, with the token as its first line");
  return line;
}

class MasterService final : public config::Service {
 public:
  explicit MasterService(MasterDaemonConfig config) : config_(std::move(config)) {}

  void start() override {
    registry_ = discovery::make_registry(config_.registry);
    OriginalGatewaysOptions original_options;
    original_options.paths = discovery::Paths(config_.sensors_root);
    original_ = std::make_unique<OriginalGateways>(*registry_, original_options);
    MasterOptions options;
    options.id = config_.id;
    options.address = config_.advertise;
    options.paths = discovery::Paths(config_.sensors_root);
    options.outcome_timeout = config_.outcome_timeout;
    options.record_for_lost_gateways = config_.record_for_lost_gateways;
    options.direct = original_.get();
    master_ = std::make_unique<Master>(*registry_, options);
    ThriftServerOptions api;
    api.host = config_.api.host;
    api.port = config_.api.port;
    api_ = std::make_unique<ThriftServer>(api, serve_api(*master_, config_.token));
    original_->start([this] { return master_->status().leading; });
    ThriftServerOptions gateways;
    gateways.host = config_.gateways.host;
    gateways.port = config_.gateways.port;
    gateways_ = std::make_unique<ThriftServer>(
        gateways, serve_original_gateways(*original_, [this] { return master_->status(); }));
    if (!config_.metrics_address.empty())
      metrics_ = std::make_unique<config::MetricsEndpoint>(config_.metrics_address, config::process_metrics(),
                                                           [this] { return trouble(); });
    logger.info("{}: API on {}:{}, registry {}", config_.id, api.host, api_->port(), config_.registry.url);
  }

  void stop(milliseconds) override { end(); }
  std::string trouble() const override {
    const MasterStatus status = master_->status();
    if (status.registry_away) return "the registry is away";
    return status.leading || !status.leader.empty() ? "" : "no master leads";
  }
  ~MasterService() override { end(); }  // start() may have thrown half way

 private:
  void end() {
    if (master_) master_->close();  // orders under way answer at once, so that the servers can end
    metrics_.reset();
    api_.reset();
    gateways_.reset();
    if (original_) original_->stop();  // it asks the master
    master_.reset();
    original_.reset();
    registry_.reset();
  }

  const MasterDaemonConfig config_;
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<OriginalGateways> original_;
  std::unique_ptr<Master> master_;
  std::unique_ptr<ThriftServer> api_;
  std::unique_ptr<ThriftServer> gateways_;
  std::unique_ptr<config::MetricsEndpoint> metrics_;
};

}  // namespace

MasterDaemonConfig load_master_config(const std::string& file) {
  auto top = config::Section::load_file(file);
  MasterDaemonConfig config;
  config.id = top.string_or("id", "master");
  config.registry = discovery::read_registry_options(top);
  config.registry.url = top.require_string("registry");
  config.registry.operation_timeout = registry_timeout;
  config.sensors_root = top.string_or("zk.root", "/iot/sensors");
  if (auto api = top.optional_section("api")) {
    read_address(*api, config.api);
    config.advertise = api->string_or("advertise", "");
    if (const auto token_file = api->optional_string("token_file"))
      config.token = first_line(*api, "token_file", *token_file);
    api->finish();
  }
  if (config.advertise.empty()) config.advertise = fmt::format("{}:{}", config.api.host, config.api.port);
  if (auto gateways = top.optional_section("gateways")) {
    read_address(*gateways, config.gateways);
    gateways->finish();
  }
  if (auto metrics = top.optional_section("metrics")) {
    config.metrics_address = metrics->require_string("address");
    metrics->finish();
  }
  if (auto orders = top.optional_section("orders")) {
    config.outcome_timeout =
        std::chrono::duration_cast<milliseconds>(orders->duration_or("wait", config.outcome_timeout));
    config.record_for_lost_gateways =
        orders->choice_or("for_lost_gateways", "record", {"record", "refuse"}) == "record";
    orders->finish();
  }
  config::read_log_settings(top);  // the frame of the daemons applies them
  top.finish();
  return config;
}

std::unique_ptr<config::Service> make_master_service(MasterDaemonConfig config) {
  return std::make_unique<MasterService>(std::move(config));
}

}  // namespace iotcloud::master
