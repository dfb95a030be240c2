#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/client/registry_client.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/zookeeper/connection.h>

namespace iotcloud::discovery {

std::unique_ptr<Registry> make_registry(const RegistryOptions& options) {
  const std::string embedded_scheme = "embedded://";
  if (options.url.starts_with(embedded_scheme)) {
    auto server = embedded::RegistryServer::named(options.url.substr(embedded_scheme.size()));
    return make_client(embedded::make_connection(std::move(server), options.session_timeout), options);
  }
  if (options.url.starts_with("zookeeper://")) {
    zookeeper::Settings settings;
    settings.url = zookeeper::parse_url(options.url);
    settings.session_timeout = options.session_timeout;
    if (!options.user.empty()) settings.identity = options.user + ":" + options.password;
    settings.others_may_read = options.others_may_read;
    return make_client(zookeeper::make_connection(std::move(settings)), options);
  }
  throw config::Error("registry URL \"" + options.url +
                      "\": unknown scheme; there are embedded://NAME and zookeeper://host:port,host:port/chroot");
}

void put(Registry& registry, const std::string& path, const std::string& data, const Fence& fence) {
  for (;;) {
    try {
      registry.set(path, data, -1, fence);
      return;
    } catch (const RegistryError& error) {
      if (error.code() != RegistryErrorCode::no_node) throw;
    }
    try {
      registry.create(path, data, true, fence);
      return;
    } catch (const RegistryError& error) {
      if (error.code() != RegistryErrorCode::exists) throw;  // another client created it meanwhile: set it
    }
  }
}

void remove_tree(Registry& registry, const std::string& path, const Fence& fence) {
  for (;;) {
    try {
      registry.remove(path, -1, fence);
      return;
    } catch (const RegistryError& error) {
      if (error.code() != RegistryErrorCode::not_empty) throw;
    }
    const auto names = registry.children(path);
    if (!names) return;
    for (const std::string& name : *names) remove_tree(registry, (path == "/" ? "" : path) + "/" + name, fence);
  }
}

}  // namespace iotcloud::discovery
