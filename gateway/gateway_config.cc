#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <system_error>

#include <fmt/format.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/brokers/broker_url.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/gateway/fleet/plugin_folder.h>
#include <iotcloud/gateway/gateway_config.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/processes/process_settings.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

namespace {

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
      section.check("urls", [&] {
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
  if (!listen.tokens.empty()) section->check("tokens", [&] { security::read_tokens(listen.tokens); });
  section->finish();
  config.gateway.host = listen.host;
  config.gateway.port = listen.port;
  config.gateway.tls = !listen.tls.empty();
  if (listen.port == 0 || file.has_errors()) return;
  const auto reached = rpc::split_address(listen.advertise);
  config.gateway.host = reached.host;
  config.gateway.port = reached.port;
}

const processes::ConfinementWords& confinement_words() {
  static const processes::ConfinementWords words{"host_", "a gateway", "driver hosts", "a driver host",
                                                 "iotcloud-host"};
  return words;
}

void read_confinement(config::YamlSection& file, ProcessLauncher::Options& hosts) {
  hosts.starter = processes::read_starter(file, confinement_words());
  hosts.confinement = processes::read_confinement(file, confinement_words(), hosts.starter);
  hosts.ports = processes::read_ports(file, confinement_words(), hosts.confinement);
  hosts.network = processes::read_network(file, confinement_words(), hosts.confinement);
  for (const auto& [plugin, places] : hosts.network) {
    const auto ports = processes::ports_of(hosts.ports, plugin);
    for (const auto& place : places) {
      if (!ports || std::find(ports->begin(), ports->end(), place.port) != ports->end()) continue;
      file.refuse("host_network",
                  fmt::format("{} for \"{}\" has a port that host_ports does not name", to_text(place), plugin),
                  "name it there, too, or leave host_ports out");
    }
  }
}

void read_plugins(config::YamlSection& file, GatewayConfig& config) {
  config.hosts.plugin_dir = file.require_string("plugins");
  if (!std::filesystem::is_directory(config.hosts.plugin_dir)) {
    file.refuse("plugins", "the folder \"" + config.hosts.plugin_dir + "\" is not there", "make it, or name another");
  } else {
    file.check("plugins", [&] { check_plugin_folder(config.hosts.plugin_dir); });
  }
  constexpr std::int64_t usual_mb = 64, most_mb = 4096;
  config.plugin_upload_limit = file.int_or("plugins.upload_limit_mb", usual_mb, 1, most_mb) << 20;
  config.trust = security::read_signers(file, "plugins");
  config.hosts.trust_folder = file.bool_or("plugins.trust_folder", false);
  config.hosts.require_version = security::read_require_version(file, "plugins", config.trust.get());
  config.hosts.allow_rollback = file.strings_or("plugins.allow_rollback", {});
  config.hosts.trust = config.trust;
}

processes::Place place_of(const std::string& url) {
  const auto server = brokers::parse_broker_url(url);
  return processes::parse_place(to_text(processes::Place{server.host, brokers::server_port(server)}));
}

void read_hosts(config::YamlSection& file, GatewayConfig& config) {
  auto& hosts = config.hosts;
  processes::read_time(file, "host_hang_limit", hosts.hang_limit);
  processes::read_time(file, "host_own_thread_hang_limit", hosts.own_thread_hang_limit);
  processes::read_time(file, "host_spin_limit", hosts.limits.spin);
  constexpr std::int64_t most_mb = 1 << 20;
  hosts.limits.memory_bytes = static_cast<std::uint64_t>(file.int_or("host_memory_limit_mb", 0, 0, most_mb)) << 20;
  read_confinement(file, hosts);
  hosts.environment = file.strings_or("host_environment", {});
  for (const auto& broker : config.gateway.brokers) {
    for (const auto& url : broker.options.urls) {
      if (file.has_errors()) break;
      file.check("brokers", [&] { hosts.brokers_places.push_back(place_of(url)); });
    }
    const auto& variable = broker.options.password_variable;
    if (!variable.empty()) hosts.environment.push_back(variable);
    for (const auto& [key, path] : brokers::files_of(broker.options)) hosts.broker_files.push_back(path);
  }
  processes::read_log_limits(file, "host_", hosts.log_limit_mb, hosts.logs_kept);
  processes::read_restarts(file, "host_", config.gateway.restart);
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
      file.check("brokers", [&] { parts = brokers::parse_broker_url(url); });
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
  file.check("id", [&] { check_name("gateway id", gateway.id); });
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
  gateway.order_keys = config.order_keys = security::read_trusted_masters(file);
  config.hosts.state_dir = file.require_string("state");
  read_hosts(file, config);
  config.provisioning_file = file.string_or("provisioning", "");
  if (!config.provisioning_file.empty() && file.runs_here()) {
    file.check("provisioning", [&] { gateway.provisioning = ProvisioningRules::load(config.provisioning_file); });
  }
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
