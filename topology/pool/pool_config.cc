#include <optional>
#include <utility>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/topology/pool/pool_config.h>

namespace iotcloud::topology {

using std::chrono::duration_cast;
using std::chrono::milliseconds;

namespace {

/// Runs a check; reports its error as an error of this configuration key.
template <typename Check>
void checked(const config::YamlSection& section, const std::string& key, Check&& check) {
  try {
    check();
  } catch (const config::ConfigError& e) {
    section.refuse(e);
  } catch (const config::Error& e) {
    section.refuse(key, e.what());
  }
}

void read_time(config::YamlSection& section, const std::string& key, milliseconds& value) {
  value = duration_cast<milliseconds>(section.duration_or(key, value));
}

void read_thrift(config::YamlSection& file, PoolConfig& config) {
  auto& listen = config.service.listen;
  auto& record = config.pool.record;
  record.host = listen.host;
  auto section = file.optional_section("thrift");
  if (!section) return;
  rpc::read_listen_settings(*section, listen, 0);
  if (!listen.tokens.empty()) checked(*section, "tokens", [&] { security::read_tokens(listen.tokens); });
  section->finish();
  record.tls = !listen.tls.empty();
  record.host = listen.host;
  if (listen.port == 0 || file.has_errors()) return;
  const auto reached = rpc::split_address(listen.advertise);
  record.host = reached.host;
  record.port = reached.port;
}

void read_keys(config::YamlSection& file, PoolConfig& config) {
  constexpr std::int64_t usual_mb = 64, most_mb = 4096;
  config.upload_limit = file.int_or("libraries.upload_limit_mb", usual_mb, 1, most_mb) << 20;
  security::TrustedKeys::Options signers;
  signers.require_signature = file.bool_or("libraries.require_signature", false);
  signers.trusted_keys = file.strings_or("libraries.trusted_keys", {});
  checked(file, signers.trusted_keys.empty() ? "libraries.require_signature" : "libraries.trusted_keys",
          [&] { config.library_keys = std::make_shared<security::TrustedKeys>(signers); });
  security::TrustedKeys::Options masters;
  masters.trusted_keys = file.strings_or("orders.trusted_keys", {});
  if (masters.trusted_keys.empty()) return;
  masters.require_signature = true;
  checked(file, "orders.trusted_keys", [&] { config.order_keys = std::make_shared<security::TrustedKeys>(masters); });
  config.pool.masters = config.order_keys;
}

void read_workers(config::YamlSection& file, PoolConfig& config) {
  constexpr std::int64_t most_mb = 1 << 20, most_kept = 1000, most_workers = 10'000;
  auto& workers = config.workers;
  config.pool.record.most_workers = static_cast<int>(file.int_or("most_workers", 0, 0, most_workers));
  read_time(file, "worker_stop_limit", workers.stop_limit);
  config.pool.stop_limit = workers.stop_limit;
  read_time(file, "worker_hang_limit", workers.hang_limit);
  read_time(file, "worker_spin_limit", workers.limits.spin);
  workers.limits.memory_bytes = static_cast<std::uint64_t>(file.int_or("worker_memory_limit_mb", 0, 0, most_mb)) << 20;
  static const processes::ConfinementWords words{"worker_", "a pool", "workers", "a worker", ""};
  workers.confinement = processes::read_confinement(file, words, false);
  workers.ports = processes::read_ports(file, words, workers.confinement);
  workers.environment = file.strings_or("worker_environment", {});
  if (auto log = file.optional_section("worker_log")) {
    workers.log_limit_mb = static_cast<int>(log->int_or("limit_mb", workers.log_limit_mb, 1, most_mb));
    workers.logs_kept = static_cast<int>(log->int_or("kept", workers.logs_kept, 0, most_kept));
    log->finish();
  }
  auto restart = file.optional_section("worker_restart");
  if (!restart) return;
  auto& policy = config.pool.restart;
  read_time(*restart, "first", policy.first);
  read_time(*restart, "longest", policy.longest);
  read_time(*restart, "healthy_after", policy.healthy_after);
  policy.give_up_after = static_cast<int>(restart->int_or("give_up_after", policy.give_up_after, 0, 1'000'000));
  restart->finish();
}

/// A pool's id is one name in the registry.
void check_id(config::YamlSection& file, const PoolConfig& config) {
  checked(file, "id", [&] { static_cast<void>(config.pool.paths.pool(config.pool.record.id)); });
}

PoolConfig read_pool(config::YamlSection& file) {
  PoolConfig config;
  config.pool.record.id = discovery::PoolId(file.require_string("id"));
  config.registry = discovery::read_registry_options(file);
  config.registry.url = file.require_string("registry");
  // A call that waits for the registry must not hold up the stop.
  config.registry.operation_timeout = milliseconds{3000};
  config.pool.session_timeout = config.registry.session_timeout;
  config.pool.paths = discovery::Paths(file.string_or("zk.root", "/iot/sensors"));
  check_id(file, config);
  read_thrift(file, config);
  config.service.audit = security::read_audit(file);
  config.service.pool = config.pool.record.id;
  read_keys(file, config);
  config.workers.pool = config.pool.record.id;
  config.workers.trust = config.library_keys;
  config.workers.state_dir = file.require_string("state");
  read_workers(file, config);
  config.pages = rpc::read_page_settings(file);
  // run_daemon() applies them; they are read here only so that finish() knows the keys
  config::read_log_settings(file);
  file.finish();
  return config;
}

}  // namespace

PoolConfig PoolConfig::load(const std::string& path) {
  std::optional<PoolConfig> config;
  config::YamlSection::read_file(path, [&](config::YamlSection& file) { config = read_pool(file); });
  return *std::move(config);
}

}  // namespace iotcloud::topology
