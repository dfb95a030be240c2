#include <optional>
#include <utility>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/topology/pool/pool_config.h>

namespace iotcloud::topology {

using std::chrono::milliseconds;

namespace {

void read_thrift(config::YamlSection& file, PoolConfig& config) {
  auto& listen = config.service.listen;
  auto& record = config.pool.record;
  record.host = listen.host;
  auto section = file.optional_section("thrift");
  if (!section) return;
  rpc::read_listen_settings(*section, listen, 0);
  if (!listen.tokens.empty()) section->check("tokens", [&] { security::read_tokens(listen.tokens); });
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
  config.library_keys = security::read_signers(file, "libraries");
  config.workers.require_version = security::read_require_version(file, "libraries", config.library_keys.get());
  config.workers.allow_rollback = file.strings_or("libraries.allow_rollback", {});
  config.order_keys = security::read_trusted_masters(file);
  config.pool.masters = config.order_keys;
}

void read_workers(config::YamlSection& file, PoolConfig& config) {
  constexpr std::int64_t most_mb = 1 << 20, most_workers = 10'000;
  auto& workers = config.workers;
  config.pool.record.most_workers = static_cast<int>(file.int_or("most_workers", 0, 0, most_workers));
  processes::read_time(file, "worker_stop_limit", workers.stop_limit);
  config.pool.stop_limit = workers.stop_limit;
  processes::read_time(file, "worker_hang_limit", workers.hang_limit);
  processes::read_time(file, "worker_call_limit", workers.call_limit);
  processes::read_time(file, "worker_spin_limit", workers.limits.spin);
  workers.limits.memory_bytes = static_cast<std::uint64_t>(file.int_or("worker_memory_limit_mb", 0, 0, most_mb)) << 20;
  static const processes::ConfinementWords words{"worker_", "a pool", "workers", "a worker", "iotcloud-worker"};
  workers.starter = processes::read_starter(file, words);
  workers.confinement = processes::read_confinement(file, words, workers.starter);
  workers.ports = processes::read_ports(file, words, workers.confinement);
  workers.environment = file.strings_or("worker_environment", {});
  processes::read_log_limits(file, "worker_", workers.log_limit_mb, workers.logs_kept);
  processes::read_restarts(file, "worker_", config.pool.restart);
}

/// A pool's id is one name in the registry.
void check_id(config::YamlSection& file, const PoolConfig& config) {
  file.check("id", [&] { static_cast<void>(config.pool.paths.pool(config.pool.record.id)); });
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
