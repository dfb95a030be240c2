#include <algorithm>
#include <iterator>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/discovery/client/registry_client.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/logger.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/zookeeper/connection.h>
#include <iotcloud/discovery/zookeeper/rights.h>

namespace iotcloud::discovery {

namespace {

/// Refuses a registry of another machine that does not know who writes to it: whoever reaches it could give orders. One
/// that does is refused too, unless the configuration says that its way is protected: whoever reads the network would
/// have the user's password.
void refuse_exposed(const RegistryOptions& options, const zookeeper::Url& url) {
  if (!options.user.empty() && options.unencrypted) return;
  for (std::size_t begin = 0; begin < url.hosts.size();) {
    const std::size_t end = std::min(url.hosts.find(',', begin), url.hosts.size());
    const std::string server = url.hosts.substr(begin, end - begin);
    std::string host = server.substr(0, server.rfind(':'));
    if (host.starts_with('[') && host.ends_with(']')) host = host.substr(1, host.size() - 2);
    if (!config::is_loopback(host)) {
      const std::string tunnel = "tunnel it to an address on 127.0.0.1 (discovery/README.md)";
      throw config::Error(
          "the registry " + server +
          (options.user.empty()
               ? " can be reached from other machines, and without a user anybody there could give orders: " + tunnel +
                     ", and give \"registry.user\" and \"registry.password_file\""
               : " is on another machine, and there is no TLS on the way to it: whoever reads the network has the "
                 "password of \"" +
                     options.user + "\". Better " + tunnel +
                     ", or say \"registry.unencrypted: true\" if something else protects the way, such as WireGuard"));
    }
    begin = end + 1;
  }
}

void warn_of_shared_user(const RegistryOptions& options) {
  logger.warn(
      "{}: all processes with the user \"{}\" have one password, and whoever takes it from one of them writes orders "
      "for all. Give each process a user of its own: \"registry.users\" (`iotcloud registry user`, "
      "discovery/README.md)",
      options.url, options.user);
}

void warn_of_open(const std::string& url) {
  logger.warn(
      "{}: without a user every process of this machine may write to the registry: give orders for any gateway and "
      "topology, and change or remove any record. Give \"registry.user\" and \"registry.password_file\" to every "
      "process "
      "(discovery/README.md), or say \"registry.open: true\" if it is meant",
      url);
}

zookeeper::Settings settings_of(const RegistryOptions& options) {
  zookeeper::Settings settings;
  settings.url = zookeeper::parse_url(options.url);
  settings.session_timeout = options.session_timeout;
  if (!options.user.empty()) settings.identity = options.user + ":" + options.password;
  settings.user = options.user;
  settings.access = options.access;
  settings.others_may_read = options.others_may_read;
  return settings;
}

}  // namespace

std::unique_ptr<Registry> make_registry(const RegistryOptions& options) {
  const std::string embedded_scheme = "embedded://";
  if (options.url.starts_with(embedded_scheme)) {
    auto server = embedded::RegistryServer::named(options.url.substr(embedded_scheme.size()));
    return make_client(embedded::make_connection(std::move(server), options.session_timeout), options);
  }
  if (options.url.starts_with("zookeeper://")) {
    zookeeper::Settings settings = settings_of(options);
    refuse_exposed(options, settings.url);
    if (options.user.empty() && !options.open) warn_of_open(options.url);
    if (!options.user.empty() && !options.access) warn_of_shared_user(options);
    return make_client(zookeeper::make_connection(std::move(settings)), options);
  }
  throw config::Error("registry URL \"" + options.url +
                      "\": unknown scheme; there are embedded://NAME and zookeeper://host:port,host:port/chroot");
}

RenewedRights renew_rights(const RegistryOptions& options, const Paths& paths,
                           const std::function<void(std::size_t)>& progress, ServersNodes servers) {
  if (!options.url.starts_with("zookeeper://"))
    throw config::Error("the registry " + options.url + " has no rights to renew; only ZooKeeper has");
  if (!options.access || !options.access->is_master(options.user))
    throw config::Error("rights are renewed by a master of the fleet's users");
  const auto settings = settings_of(options);
  refuse_exposed(options, settings.url);
  return zookeeper::renew_rights(settings, paths, options.operation_timeout, progress, servers);
}

namespace {

/// Makes a branch if it is not there. While the registry is away nothing is made: the next connection makes it.
void make_branch(Registry& registry, const std::string& branch) {
  try {
    if (!registry.get(branch)) registry.create(branch, "");
  } catch (const RegistryError& error) {
    if (error.code() == RegistryErrorCode::away || error.code() == RegistryErrorCode::closed) return;
    if (error.code() == RegistryErrorCode::exists) return;  // by another master meanwhile
    logger.error(
        "{}; all records of its kind are below that node. If another process made it, and keeps masters out, "
        "`iotcloud registry rights` takes it away and makes it anew",
        error.what());
  }
}

class BranchKeeper final : public Guard {
 public:
  BranchKeeper(Registry& registry, const std::vector<std::string>& branches) {
    for (const auto& branch : branches) {
      guards_.push_back(registry.watch_node(branch, [&registry, branch](const std::optional<Node>& node) {
        if (!node) make_branch(registry, branch);
      }));
    }
    // A watch reports nothing of a node that keeps this user out; this tells of it.
    guards_.push_back(registry.on_session([&registry, branches](SessionState state) {
      if (state != SessionState::connected) return;
      for (const auto& branch : branches) make_branch(registry, branch);
    }));
  }

 private:
  std::vector<GuardPtr> guards_;
};

}  // namespace

GuardPtr keep_branches(Registry& registry, const Paths& paths) {
  return std::make_unique<BranchKeeper>(registry, paths.branches());
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
