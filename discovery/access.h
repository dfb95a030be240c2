#pragma once

#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>

namespace iotcloud::discovery {

/// A process's identity at ZooKeeper: one line "ROLE USER:DIGEST" of the users' file, the digest as ZooKeeper has it
/// (base64 of SHA-1 of "USER:PASSWORD").
struct RegistryUser {
  /// The kinds of processes. A gateway's user has the gateway's id as its name.
  enum class Role { master, gateway, worker };
  Role role = Role::worker;
  std::string name;
  std::string digest;
};

/// Reads the users' file, which all processes of a fleet share; it has no secrets. Empty lines and lines that begin
/// with '#' are skipped. \throws config::Error with file and line.
std::vector<RegistryUser> read_registry_users(const std::string& file);

/// The access rules of the registry's nodes: only masters write orders and removals of orders, only a gateway (and
/// masters) its own records, only a gateway and masters read its orders. A gateway takes away the removals that it has
/// followed. Only masters make the branches (keep_branches()): whoever made one would own all that is below. Every
/// process gives the nodes that it creates these rights, whoever they are for. Immutable: thread safe.
class RegistryAccess {
 public:
  /// Rights on one node, as ZooKeeper has them: `create` and `remove` are about its children.
  static constexpr int read = 1, write = 2, create = 4, remove = 8, all = 31;
  /// The permissions of one user for a node.
  struct Grant {
    std::string id;  ///< "USER:DIGEST"
    int rights = 0;
  };
  RegistryAccess(std::vector<RegistryUser> users, Paths paths) : users_(std::move(users)), paths_(std::move(paths)) {}

  bool knows(const std::string& user) const;
  bool is_gateway(const std::string& user) const { return is(user, RegistryUser::Role::gateway); }
  bool is_master(const std::string& user) const { return is(user, RegistryUser::Role::master); }
  /// The rights on a node at that path which this user creates; users without any are not in it.
  std::vector<Grant> grants(const std::string& path, const std::string& creator) const;

 private:
  bool is(const std::string& user, RegistryUser::Role role) const;
  int rights_of(const RegistryUser& user, const std::string& path, const std::string& creator) const;
  int of_gateway(const std::string& id, const std::string& path, const std::string& creator) const;
  int of_worker(const std::string& path) const;
  bool is_of_orders(const std::string& path) const;

  const std::vector<RegistryUser> users_;
  const Paths paths_;
};

}  // namespace iotcloud::discovery
