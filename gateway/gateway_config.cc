#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <system_error>

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/brokers/broker_url.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/gateway/fleet/plugin_folder.h>
#include <iotcloud/gateway/gateway_config.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/processes/landlock.h>

namespace iotcloud::gateway {

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

std::vector<brokers::BrokerSetting> read_brokers(config::YamlSection& file, milliseconds session_timeout) {
  std::vector<brokers::BrokerSetting> brokers;
  for (auto& named : file.sections("brokers")) {
    const std::string& name = named.first;
    config::YamlSection& section = named.second;
    brokers::BrokerSetting broker;
    broker.name = name;
    broker.type = section.choice_or("type", name, brokers::broker_kinds());
    broker.options = brokers::read_broker_options(section, session_timeout);
    section.finish();
    if (broker.options.urls.empty()) section.refuse("urls", "there is none", "give the broker's URL");
    if (broker.type == "embedded") {
      section.refuse("type", "the embedded broker is inside one process, and driver hosts are others",
                     "use a broker that is a server, or local mode");
    }
    for (const std::string& url : broker.options.urls) {
      checked(section, "urls", [&] {
        const std::string kind = brokers::broker_kind(url);
        if (kind == broker.type) return;
        throw section.error("urls",
                            "\"" + brokers::printable_url(url) + "\" is a URL of " + kind + ", not of " + broker.type,
                            "give a URL of the broker's type, or another type");
      });
    }
    brokers.push_back(std::move(broker));
  }
  if (brokers.empty()) file.refuse("brokers", "there is none", "name at least one, for drivers to publish to");
  return brokers;
}

void read_thrift(config::YamlSection& file, GatewayConfig& config) {
  auto& listen = config.thrift.listen;
  config.gateway.host = listen.host;
  config.gateway.port = listen.port;
  auto section = file.optional_section("thrift");
  if (!section) return;
  rpc::read_listen_settings(*section, listen, 0);
  if (!listen.tokens.empty()) checked(*section, "tokens", [&] { security::read_tokens(listen.tokens); });
  section->finish();
  config.gateway.host = listen.host;
  config.gateway.port = listen.port;
  config.gateway.tls = !listen.tls.empty();
  if (listen.port == 0 || file.has_errors()) return;
  const auto reached = rpc::split_address(listen.advertise);
  config.gateway.host = reached.host;
  config.gateway.port = reached.port;
}

/// Reads the confinement of driver hosts, and checks now, rather than when the first driver is deployed, that this
/// machine allows it.
void read_confinement(config::YamlSection& file, ProcessLauncher::Options& hosts) {
  auto& confinement = hosts.confinement;
  confinement.no_new_privileges = true;
  confinement.filter_calls = file.bool_or("host_call_filter", true);
  confinement.debuggable = file.bool_or("host_debugging", false);
  confinement.user = file.string_or("host_user", "");
  hosts.starter = file.string_or("host_starter", "");
  if (!hosts.starter.empty() && confinement.user.empty()) {
    file.refuse("host_starter", "it starts driver hosts as a user of their own, which is not named",
                "host_user: iotcloud-host");
  }
  constexpr std::int64_t fewest_files = 64, most_files = 1 << 20;
  confinement.open_files = static_cast<std::uint64_t>(file.int_or("host_open_files", 0, 0, most_files));
  if (confinement.open_files > 0 && confinement.open_files < fewest_files) {
    file.refuse("host_open_files", "a driver host alone needs some", fmt::format("at least {}", fewest_files));
  }
  constexpr std::int64_t most_processes = 1 << 22;
  confinement.processes = static_cast<std::uint64_t>(file.int_or("host_processes", 0, 0, most_processes));
  if (auto files = file.optional_section("host_files")) {
    confinement.files.emplace();
    confinement.files->read = files->strings_or("read", {});
    confinement.files->write = files->strings_or("write", {});
    files->finish();
  }
  rlimit now{};
  getrlimit(RLIMIT_NOFILE, &now);
  if (geteuid() != 0 && confinement.open_files > now.rlim_max) {
    file.refuse("host_open_files", fmt::format("only root may give more than the {} that this user has", now.rlim_max));
  }
  if (confinement.user.empty()) return;
  checked(file, "host_user", [&] {
    const processes::Account account = processes::find_account(confinement.user);
    if (account.user == 0) throw config::Error("driver hosts would run as root: name a user with no rights");
    if (!hosts.starter.empty() || geteuid() == 0 || geteuid() == account.user) return;
    throw config::Error(
        fmt::format("only a gateway that runs as root can run its driver hosts as {} itself; let systemd start them "
                    "(host_starter: /run/iotcloud-host), or leave this out",
                    confinement.user));
  });
}

/// Reads the ports to which hosts may connect.
void read_ports(config::YamlSection& file, ProcessLauncher::Options& hosts) {
  const std::string key = "host_ports";
  auto section = file.optional_section(key);
  if (!section) return;
  constexpr int highest = 65535;
  for (const std::string& plugin : section->names()) {
    for (const std::string& text : section->strings_or(plugin, {})) {
      const auto port = config::parse_number<std::uint16_t>(text);
      if (!port || *port == 0) {
        section->refuse(plugin, fmt::format("\"{}\" is no port", text), fmt::format("1 to {}", highest));
        continue;
      }
      hosts.ports[plugin].push_back(*port);
    }
  }
  section->finish();
  if (hosts.ports[ProcessLauncher::every_plugin].empty()) {
    file.refuse(key, "it names no ports for every plugin, and hosts would not reach the brokers",
                fmt::format("{}: [5672]", ProcessLauncher::every_plugin));
  }
  if (!hosts.confinement.filter_calls) {
    file.refuse(key, "hosts would get around it with the system calls that they then have", "host_call_filter: true");
  }
  if (processes::landlock_version() < processes::landlock_of_connections) {
    file.refuse(key, "this kernel cannot restrict what its processes connect to: it takes Linux 6.7 with Landlock",
                "leave it out, and use a firewall or systemd's IPAddressAllow (deploy/README.md)");
  }
}

void read_plugins(config::YamlSection& file, GatewayConfig& config) {
  config.hosts.plugin_dir = file.require_string("plugins");
  if (!std::filesystem::is_directory(config.hosts.plugin_dir)) {
    file.refuse("plugins", "the folder \"" + config.hosts.plugin_dir + "\" is not there", "make it, or name another");
  } else {
    checked(file, "plugins", [&] { check_plugin_folder(config.hosts.plugin_dir); });
  }
  constexpr std::int64_t usual_mb = 64, most_mb = 4096;
  config.plugin_upload_limit = file.int_or("plugins.upload_limit_mb", usual_mb, 1, most_mb) << 20;
  security::TrustedKeys::Options trust;
  trust.require_signature = file.bool_or("plugins.require_signature", false);
  trust.trusted_keys = file.strings_or("plugins.trusted_keys", {});
  config.hosts.require_version = file.bool_or("plugins.require_version", false);
  config.hosts.allow_rollback = file.strings_or("plugins.allow_rollback", {});
  checked(file, trust.trusted_keys.empty() ? "plugins.require_signature" : "plugins.trusted_keys",
          [&] { config.trust = std::make_shared<security::TrustedKeys>(trust); });
  config.hosts.trust = config.trust;
}

void read_orders(config::YamlSection& file, GatewayConfig& config) {
  security::TrustedKeys::Options masters;
  masters.trusted_keys = file.strings_or("orders.trusted_keys", {});
  if (masters.trusted_keys.empty()) return;
  masters.require_signature = true;
  checked(file, "orders.trusted_keys", [&] { config.order_keys = std::make_shared<security::TrustedKeys>(masters); });
  config.gateway.order_keys = config.order_keys;
}

void read_hosts(config::YamlSection& file, GatewayConfig& config) {
  const auto time = [](config::YamlSection& section, const std::string& key, milliseconds& value) {
    value = duration_cast<milliseconds>(section.duration_or(key, value));
  };
  auto& hosts = config.hosts;
  time(file, "host_hang_limit", hosts.hang_limit);
  time(file, "host_own_thread_hang_limit", hosts.own_thread_hang_limit);
  time(file, "host_spin_limit", hosts.limits.spin);
  constexpr std::int64_t most_mb = 1 << 20;
  hosts.limits.memory_bytes = static_cast<std::uint64_t>(file.int_or("host_memory_limit_mb", 0, 0, most_mb)) << 20;
  read_confinement(file, hosts);
  read_ports(file, hosts);
  hosts.environment = file.strings_or("host_environment", {});
  for (const auto& broker : config.gateway.brokers) {
    const auto& variable = broker.options.password_variable;
    if (!variable.empty()) hosts.environment.push_back(variable);
    if (!hosts.confinement.files) continue;
    for (const auto& [key, path] : brokers::files_of(broker.options)) hosts.confinement.files->read.push_back(path);
  }
  if (auto log = file.optional_section("host_log")) {
    constexpr int most_kept = 1000;
    hosts.log_limit_mb = static_cast<int>(log->int_or("limit_mb", hosts.log_limit_mb, 1, most_mb));
    hosts.logs_kept = static_cast<int>(log->int_or("kept", hosts.logs_kept, 0, most_kept));
    log->finish();
  }
  auto restart = file.optional_section("host_restart");
  if (!restart) return;
  auto& policy = config.gateway.restart;
  time(*restart, "first", policy.first);
  time(*restart, "longest", policy.longest);
  time(*restart, "healthy_after", policy.healthy_after);
  policy.give_up_after = static_cast<int>(restart->int_or("give_up_after", policy.give_up_after, 0, 1'000'000));
  restart->finish();
}

/// Where gateways share an exchange, each one's rights are the keys that begin with its id and a dot: those of a
/// gateway "a" would cover the keys of a gateway "a.b".
void check_id(config::YamlSection& file, const GatewayOptions& gateway) {
  if (gateway.id.str().find('.') == std::string::npos) return;
  for (const auto& broker : gateway.brokers) {
    if (!broker.options.properties.contains("exchange")) continue;
    file.refuse("id",
                fmt::format("\"{}\" has a dot, and the broker \"{}\" has the property \"exchange\": a gateway whose id "
                            "ends at the dot could write and read this one's messages there",
                            gateway.id, broker.name),
                "give the gateway an id without dots, or leave the property out");
  }
}

/// A channel's record names the broker's URL as it stands in the file, and every process of the fleet reads it: with
/// users of their own at the registry they are not to have one another's password of a broker. One on loopback is of
/// another use on each machine, such as RabbitMQ's guest.
void check_published_urls(config::YamlSection& file, const GatewayConfig& config) {
  if (!config.registry.access) return;
  for (const auto& broker : config.gateway.brokers) {
    const auto& urls = broker.options.urls;
    const auto found = std::find_if(urls.begin(), urls.end(), [&](const std::string& url) {
      brokers::BrokerUrl parts;
      checked(file, "brokers", [&] { parts = brokers::parse_broker_url(url); });
      return !parts.password.empty() && !config::is_loopback(parts.host);
    });
    if (found == urls.end()) continue;
    file.refuse("brokers",
                fmt::format("the broker \"{}\" has its password in the URL {}, which the records of channels show to "
                            "every gateway and worker of \"registry.users\"",
                            broker.name, brokers::printable_url(*found)),
                "give `user` and `password_file`, and the URL without them");
  }
}

GatewayConfig read_gateway(config::YamlSection& file) {
  GatewayConfig config;
  auto& gateway = config.gateway;
  gateway.id = discovery::GatewayId(file.require_string("id"));
  checked(file, "id", [&] { check_name("gateway id", gateway.id); });
  config.registry = discovery::read_registry_options(file);
  config.registry.url = file.require_string("registry");
  // A call that waits for the registry must not hold up the stop.
  config.registry.operation_timeout = milliseconds{3000};
  gateway.session_timeout = config.registry.session_timeout;
  gateway.paths = discovery::Paths(file.string_or("zk.root", "/iot/sensors"));
  gateway.brokers = read_brokers(file, gateway.session_timeout);
  check_id(file, gateway);
  check_published_urls(file, config);
  read_thrift(file, config);
  config.audit = security::read_audit(file);
  read_plugins(file, config);
  read_orders(file, config);
  config.hosts.state_dir = file.require_string("state");
  read_hosts(file, config);
  config.pages = rpc::read_page_settings(file);
  // run_daemon() applies them; they are read here only so that finish() knows the keys
  config::read_log_settings(file);
  file.finish();
  return config;
}

}  // namespace

GatewayConfig GatewayConfig::load(const std::string& path) {
  std::optional<GatewayConfig> config;
  config::YamlSection::read_file(path, [&](config::YamlSection& file) { config = read_gateway(file); });
  return *std::move(config);
}

}  // namespace iotcloud::gateway
