#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/daemon/reload.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/api/worker_pages.h>
#include <iotcloud/master/console/api_calls.h>
#include <iotcloud/master/console/console.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/master_service.h>
#include <iotcloud/master/originals/gateway_handler.h>
#include <iotcloud/master/originals/original_gateways.h>
#include <iotcloud/master/pools/library_relay.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::master {

using std::chrono::milliseconds;

namespace {

/// The registry's operation time-out. Shorter than the time that a daemon may take to stop, because calls that wait for
/// an absent registry delay the stop.
constexpr milliseconds registry_timeout{3'000};

/// Gateways of the original system have neither TLS nor tokens, so only this machine may reach this address, and only
/// those of its users who are named here, if not all.
void read_original_address(config::YamlSection& section, rpc::ListenSettings& address) {
  address.host = section.string_or("host", address.host);
  address.port = static_cast<int>(section.int_or("port", address.port, 1, 65535));
  address.users = section.strings_or("users", {});
  address.open = section.bool_or("open", false);
  if (config::is_loopback(address.host)) return;
  section.refuse("host",
                 fmt::format("{} can be reached from other machines, and gateways of the original system speak no "
                             "TLS: anybody there could register one",
                             address.host),
                 "127.0.0.1; from elsewhere use a tunnel, for example ssh -L 12903:127.0.0.1:12903 HOST");
}

rpc::ThriftServerOptions server_options(const char* name, const rpc::ListenSettings& settings) {
  rpc::ThriftServerOptions options;
  options.name = name;
  options.host = settings.host;
  options.port = settings.port;
  options.tls = settings.tls;
  return options;
}

/// This master must be able to change its own orders. \throws config::Error if it does not trust its own key.
void check_own_key(const MasterDaemonConfig& config) {
  if (config.signing_key.empty()) return;
  const std::string place = "/", object = R"({"a":1})";
  const auto signed_object = security::sign_object(security::ObjectSigner(config.signing_key), place, object);
  if (security::signer_of_object(*config.order_keys, place, signed_object).empty())
    throw config::Error("none of these keys is that of signing_key, with which this master signs: add its .pub file");
}

class MasterService final : public config::DaemonService {
 public:
  explicit MasterService(MasterDaemonConfig config) : config_(std::move(config)) {}

  void start(const std::stop_token&) override {
    if (const auto problem = rpc::exposure(config_.api); !problem.empty()) throw config::Error(problem);
    if (!config_.api.tokens.empty()) tokens_ = std::make_shared<security::TokenKeeper>(config_.api.tokens, "api");
    if (!config_.audit.file.empty()) audit_ = std::make_shared<security::AuditLog>(config_.audit);
    registry_ = discovery::make_registry(config_.registry);
    if (config_.gateways) {
      OriginalGatewaysOptions original_options;
      original_options.paths = discovery::Paths(config_.sensors_root);
      original_options.access = config_.registry.access;
      original_ = std::make_unique<OriginalGateways>(*registry_, original_options);
    }
    if (!config_.gateway_token_file.empty() && config_.gateway_token_file.find("{gateway}") == std::string::npos)
      logger.warn(
          "this master shows every gateway the same token, so whoever has one gateway's token file knows what "
          "others take: give each its own, with {{gateway}} in api.gateway_token_file");
    MasterOptions options;
    options.id = config_.id;
    options.address = config_.api.advertise;
    options.paths = discovery::Paths(config_.sensors_root);
    options.outcome_timeout = config_.outcome_timeout;
    options.record_for_lost_gateways = config_.record_for_lost_gateways;
    options.direct = original_.get();
    if (!config_.signing_key.empty()) {
      options.seal = [key = security::ObjectSigner(config_.signing_key)](const auto& path, const auto& bytes) {
        return security::sign_object(key, path, bytes);
      };
      if (!config_.order_keys)
        logger.warn("this master signs what it makes of an order whoever wrote it: set orders.trusted_keys");
    }
    if (config_.order_keys) {
      options.is_sealed = [keys = config_.order_keys](const auto& path, const auto& bytes) {
        return !security::signer_of_object(*keys, path, bytes).empty();
      };
    }
    master_ = std::make_unique<Master>(*registry_, options);
    ApiAccess access;
    access.tokens = tokens_;
    access.users = config_.api.users;
    access.open = config_.api.open;
    access.calls = config_.api.calls;
    access.audit = audit_;
    access.gateways = {config_.api.tls, config_.gateway_token_file};
    access.workers = {config_.api.tls, config_.worker_token_file};
    access.pools = {config_.api.tls, config_.pool_token_file};
    relay_ = std::make_unique<LibraryRelay>(*master_, *registry_,
                                            LibraryRelay::Options{.paths = options.paths, .access = access.pools});
    const auto served = serve_api(*master_, access);
    api_ = std::make_unique<rpc::ThriftServer>(server_options("api", config_.api), served);
    if (!config_.console.pages.address.empty()) start_console(served, access);
    if (original_) {
      original_->start([this] { return master_->status().leading; });
      gateways_ = std::make_unique<rpc::ThriftServer>(
          server_options("gateways", *config_.gateways),
          serve_original_gateways(*original_, [this] { return master_->status(); },
                                  {.users = config_.gateways->users, .open = config_.gateways->open, .audit = audit_}));
    }
    if (!config_.pages.address.empty())
      metrics_ = std::make_unique<rpc::MetricsEndpoint>(config_.pages, config::process_metrics(),
                                                        [this] { return trouble(); });
    logger.info("{}: API on {}:{} {}, registry {}", config_.id, config_.api.host, api_->port(),
                config_.api.tls.empty() ? "without TLS" : "with TLS", config_.registry.url);
  }

  void reload() override {
    config::Reload parts;
    if (audit_) parts.part([&] { audit_->reopen(); });
    if (config_.order_keys) parts.part([&] { config_.order_keys->reload(); });
    if (tokens_) parts.part([&] { tokens_->reload(); });
    parts.part([&] { api_->reload(); });  // after the tokens: it closes connections whose token is gone
    if (metrics_) parts.part([&] { metrics_->reload(); });
    if (console_) parts.part([&] { console_->reload(); });
    parts.finish();
  }

  void stop(milliseconds) override { end(); }
  std::string trouble() const override {
    const MasterStatus status = master_->status();
    if (status.registry_away) return "the registry is away";
    return status.leading || !status.leader.empty() ? "" : "no master leads";
  }
  ~MasterService() override { end(); }  // frees what start() made before it threw

 private:
  void start_console(const rpc::ThriftService& served, const ApiAccess& access) {
    Live::Source source;
    source.status = [this] { return master_->status(); };
    source.drivers = [this] { return master_->drivers(); };
    source.gateways = [this] { return master_->gateways(); };
    source.topologies = [this] { return master_->topologies(); };
    source.carried = [this, gateways = access.gateways] { return read_carried(*master_, gateways, console_asks_); };
    source.worker_page = [this, workers = access.workers](const auto& topology, const auto& worker) {
      return read_worker_page(*master_, workers, topology, worker, "/topology");
    };
    Console::Options options{.settings = config_.console,
                             .id = config_.id,
                             .tokens = tokens_,
                             .users = config_.api.users,
                             .open = config_.api.open,
                             .audit_file = config_.audit.file};
    calls_ = calls_of_api(served);
    console_ = std::make_unique<Console>(std::move(options), std::move(source), *calls_);
    logger.info("{}: console at {}", config_.id, console_->url());
  }

  void end() {
    if (master_) master_->close();  // orders under way return at once, so that the servers can end
    console_.reset();
    metrics_.reset();
    api_.reset();
    gateways_.reset();
    relay_.reset();
    if (original_) original_->stop();  // before the master goes, because it asks the master
    master_.reset();
    original_.reset();
    registry_.reset();
  }

  const MasterDaemonConfig config_;
  std::shared_ptr<security::TokenKeeper> tokens_;
  std::shared_ptr<security::AuditLog> audit_;
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<OriginalGateways> original_;
  std::unique_ptr<Master> master_;
  std::unique_ptr<LibraryRelay> relay_;
  std::unique_ptr<rpc::ThriftServer> api_;
  std::unique_ptr<rpc::ThriftServer> gateways_;
  std::unique_ptr<rpc::MetricsEndpoint> metrics_;
  std::unique_ptr<ConsoleCalls> calls_;
  GatewayAsks console_asks_;  ///< of the console, which ends first
  std::unique_ptr<Console> console_;
};

MasterDaemonConfig read_master(config::YamlSection& top) {
  MasterDaemonConfig config;
  config.id = top.string_or("id", "master");
  config.registry = discovery::read_registry_options(top);
  config.registry.url = top.require_string("registry");
  config.registry.operation_timeout = registry_timeout;
  config.sensors_root = top.string_or("zk.root", "/iot/sensors");
  if (auto api = top.optional_section("api")) {
    rpc::read_listen_settings(*api, config.api);
    if (!config.api.tokens.empty()) api->check("tokens", [&] { security::read_tokens(config.api.tokens); });
    config.gateway_token_file = api->string_or("gateway_token_file", "");
    const bool for_each = config.gateway_token_file.find("{gateway}") != std::string::npos;
    if (!config.gateway_token_file.empty() && !for_each && !std::filesystem::exists(config.gateway_token_file))
      api->refuse("gateway_token_file", "the file \"" + config.gateway_token_file + "\" is not there",
                  "a file whose first line is a token that the gateways know");
    config.worker_token_file = api->string_or("worker_token_file", "");
    if (!config.worker_token_file.empty() && !std::filesystem::exists(config.worker_token_file))
      api->refuse("worker_token_file", "the file \"" + config.worker_token_file + "\" is not there",
                  "a file whose first line is a token that the pages of topologies' workers take");
    config.pool_token_file = api->string_or("pool_token_file", "");
    const bool for_each_pool = config.pool_token_file.find("{pool}") != std::string::npos;
    if (!config.pool_token_file.empty() && !for_each_pool && !std::filesystem::exists(config.pool_token_file))
      api->refuse("pool_token_file", "the file \"" + config.pool_token_file + "\" is not there",
                  "a file whose first line is a token that the pools of workers know");
    api->finish();
  }
  if (config.api.advertise.empty()) config.api.advertise = fmt::format("{}:{}", config.api.host, config.api.port);
  if (auto gateways = top.optional_section("gateways")) {
    config.gateways = rpc::ListenSettings{"127.0.0.1", 12903, {}, "", ""};
    read_original_address(*gateways, *config.gateways);
    gateways->finish();
  }
  config.audit = security::read_audit(top);
  config.pages = rpc::read_page_settings(top);
  config.console = read_console_settings(top, config.api.tokens);
  if (auto orders = top.optional_section("orders")) {
    config.outcome_timeout =
        std::chrono::duration_cast<milliseconds>(orders->duration_or("wait", config.outcome_timeout));
    config.record_for_lost_gateways =
        orders->choice_or("for_lost_gateways", "record", {"record", "refuse"}) == "record";
    config.signing_key = orders->string_or("signing_key", "");
    if (!config.signing_key.empty()) orders->check("signing_key", [&] { security::ObjectSigner{config.signing_key}; });
    security::TrustedKeys::Options masters;
    masters.trusted_keys = orders->strings_or("trusted_keys", {});
    masters.require_signature = true;
    if (!masters.trusted_keys.empty())
      orders->check("trusted_keys", [&] {
        config.order_keys = std::make_shared<security::TrustedKeys>(masters);
        check_own_key(config);
      });
    orders->finish();
  }
  config::read_log_settings(top);  // only checks these keys: the frame of the daemon (config/) applies them
  top.finish();
  return config;
}

}  // namespace

MasterDaemonConfig load_master_config(const std::string& file) {
  std::optional<MasterDaemonConfig> config;
  config::YamlSection::read_file(file, [&](config::YamlSection& top) { config = read_master(top); });
  return *std::move(config);
}

std::unique_ptr<config::DaemonService> make_master_service(MasterDaemonConfig config) {
  return std::make_unique<MasterService>(std::move(config));
}

}  // namespace iotcloud::master
