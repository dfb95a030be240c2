#include <algorithm>
#include <fstream>
#include <sstream>
#include <string_view>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/access.h>

namespace iotcloud::discovery {

namespace {

bool is_below(const std::string& path, const std::string& root) {
  return path.size() > root.size() && path.starts_with(root) && path[root.size()] == '/';
}

bool is_at_or_below(const std::string& path, const std::string& root) {
  return path == root || is_below(path, root);
}

}  // namespace

std::vector<RegistryUser> read_registry_users(const std::string& file) {
  std::ifstream in(file);
  if (!in) throw config::Error("the users' file " + file + " cannot be read; `iotcloud registry user` makes one");
  std::vector<RegistryUser> users;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line.starts_with('#')) continue;
    std::istringstream words(line);
    std::string role, id, more;
    words >> role >> id;
    const auto colon = id.find(':');
    RegistryUser user;
    const bool known = role == "master" || role == "gateway" || role == "worker";
    if (!known || colon == std::string::npos || colon == 0 || colon + 1 == id.size() || words >> more) {
      throw config::Error(file + ":" + std::to_string(number) +
                          ": not a line ROLE USER:DIGEST with the role master, gateway or worker; `iotcloud registry "
                          "user` writes them");
    }
    user.role = role == "master"    ? RegistryUser::Role::master
                : role == "gateway" ? RegistryUser::Role::gateway
                                    : RegistryUser::Role::worker;
    user.name = id.substr(0, colon);
    user.digest = id.substr(colon + 1);
    const auto same = [&](const RegistryUser& other) { return other.name == user.name; };
    if (std::any_of(users.begin(), users.end(), same))
      throw config::Error(file + ":" + std::to_string(number) + ": there is a user " + user.name + " already");
    users.push_back(std::move(user));
  }
  return users;
}

bool RegistryAccess::knows(const std::string& user) const {
  return std::any_of(users_.begin(), users_.end(), [&](const RegistryUser& one) { return one.name == user; });
}

bool RegistryAccess::is(const std::string& user, RegistryUser::Role role) const {
  return std::any_of(users_.begin(), users_.end(),
                     [&](const RegistryUser& one) { return one.name == user && one.role == role; });
}

std::vector<RegistryAccess::Grant> RegistryAccess::grants(const std::string& path, const std::string& creator) const {
  std::vector<Grant> grants;
  for (const auto& user : users_) {
    if (const int rights = rights_of(user, path, creator); rights != 0)
      grants.push_back({user.name + ":" + user.digest, rights});
  }
  return grants;
}

int RegistryAccess::rights_of(const RegistryUser& user, const std::string& path, const std::string& creator) const {
  if (user.role == RegistryUser::Role::master) return all;
  const auto branches = paths_.branches();
  const bool in_a_branch =
      std::any_of(branches.begin(), branches.end(), [&](const auto& root) { return is_at_or_below(path, root); });
  if (!in_a_branch) return read;  // above the branches, which masters make: keep_branches()
  return user.role == RegistryUser::Role::gateway ? of_gateway(user.name, path, creator) : of_worker(path);
}

int RegistryAccess::of_gateway(const std::string& id, const std::string& path, const std::string& creator) const {
  if (is_at_or_below(path, paths_.sensors)) {
    // Instances of all gateways are below their driver's node; its name and that of the branch belong to all of them.
    const auto levels = std::count(path.begin() + static_cast<std::ptrdiff_t>(paths_.sensors.size()), path.end(), '/');
    if (levels < 2) return read | create | remove;
    return id == creator ? all : read;
  }
  if (path == paths_.gateways) return read | create;
  if (!is_below(path, paths_.gateways)) return read;
  const GatewayId own(id);
  if (is_at_or_below(path, paths_.orders(own)) || is_below(path, paths_.removals(own))) return read;
  if (path == paths_.removals(own)) return read | remove;  // it takes away those that it has followed
  if (is_at_or_below(path, paths_.gateway(own))) return all;
  return is_of_orders(path) ? 0 : read;
}

/// Whether a node below a gateway's is that of its orders or of their removals, or one of them.
bool RegistryAccess::is_of_orders(const std::string& path) const {
  const auto name_end = std::min(path.find('/', paths_.gateways.size() + 1), path.size());
  const std::string rest = path.substr(name_end);
  return is_at_or_below(rest, "/orders") || is_at_or_below(rest, "/removals");
}

int RegistryAccess::of_worker(const std::string& path) const {
  for (const auto& branch : {paths_.groups, paths_.pools, paths_.topologies}) {
    if (path == branch) return read | create | remove;  // it is all workers', so none of them may shut others out
  }
  if (is_below(path, paths_.groups) || is_below(path, paths_.pools)) return all;
  if (!is_below(path, paths_.topologies)) {
    return is_below(path, paths_.gateways) && is_of_orders(path) ? 0 : read;
  }
  const auto level = std::count(path.begin() + static_cast<std::ptrdiff_t>(paths_.topologies.size()), path.end(), '/');
  return level == 2 && path.ends_with("/wanted") ? read : all;
}

}  // namespace iotcloud::discovery
