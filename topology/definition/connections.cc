#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/discovery/registry_setting.h>
#include <iotcloud/topology/definition/connections.h>

namespace iotcloud::topology {

using config::YamlSection;

namespace {

/// Makes a registry URL from zk.servers; the key `registry` overrides it.
std::string read_registry_url(YamlSection& root) {
  const auto servers = root.strings_or("zk.servers", {});
  auto registry = root.string_or("registry", "");
  if (!registry.empty() || servers.empty()) return registry;
  std::string url = "zookeeper://";
  for (const auto& server : servers) {
    const auto colon = server.rfind(':');
    if (colon == std::string::npos || colon == 0 || colon + 1 == server.size()) {
      root.refuse("zk.servers", "\"" + server + "\" is not a server", "host:port is expected (2181 is usual)");
    }
    url += (url.back() == '/' ? "" : ",") + server;
  }
  return url;
}

/// Refuses credentials without URLs: they would go to any address that a channel's record names, without TLS if the
/// record says so.
void refuse_aimless_credentials(const YamlSection& broker, const brokers::BrokerOptions& options) {
  if (!options.urls.empty() || !brokers::are_credentials_given(options)) return;
  broker.refuse("urls",
                "user, password and TLS are given here, but no address: they would go to whatever address a "
                "channel's record in the registry names",
                "list the broker's own addresses, for example \"urls: [amqps://broker:5671/]\"");
}

}  // namespace

discovery::RegistryOptions read_registry(YamlSection& root) {
  auto options = discovery::read_registry_options(root);
  options.url = read_registry_url(root);
  return options;
}

std::string read_zk_root(YamlSection& root) {
  auto path = root.string_or("zk.root", "/iot/sensors");
  if (path.size() < 2 || path.front() != '/' || path.back() == '/')
    root.refuse("zk.root", "\"" + path + "\" is not a path", "/iot/sensors is usual");
  return path;
}

std::map<std::string, brokers::BrokerOptions> read_brokers(YamlSection& root,
                                                           std::chrono::milliseconds session_timeout) {
  std::map<std::string, brokers::BrokerOptions> brokers;
  auto section = root.optional_section("brokers");
  if (!section) return brokers;
  for (const std::string& name : section->names()) {
    auto& options = brokers[name];
    if (section->is_mapping(name)) {
      YamlSection broker = section->require_section(name);
      options = brokers::read_broker_options(broker, session_timeout);
      broker.finish();
      refuse_aimless_credentials(broker, options);
    } else {
      options.heartbeat = brokers::usual_heartbeat(session_timeout);
      if (const std::string url = section->string_or(name, ""); !url.empty()) options.urls = {url};
    }
  }
  section->finish();
  return brokers;
}

}  // namespace iotcloud::topology
