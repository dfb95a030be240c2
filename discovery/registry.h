#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/error.h>

namespace iotcloud::discovery {

/// Why a registry call failed.
enum class RegistryErrorCode {
  no_node,      ///< the path, or its parent, does not exist
  exists,       ///< create: the node exists already
  not_empty,    ///< remove: the node has children
  bad_version,  ///< set or remove: the node was changed meanwhile
  bad_path,     ///< not of the form /a/b/c, or a child of an ephemeral node
  away,         ///< no connection within the time-out: whether a write took effect is unknown
  closed,       ///< the registry object was closed
  too_large,    ///< more data than a node may have (max_node_size)
  denied,       ///< the node belongs to another user: RegistryOptions::user
  fenced,       ///< the write's fence is gone: Fence
};

/// A registry call that failed. what() names the path and, where there is one, the remedy.
class RegistryError : public config::Error {
 public:
  RegistryError(RegistryErrorCode code, const std::string& text) : Error(text), code_(code) {}
  RegistryErrorCode code() const { return code_; }

 private:
  RegistryErrorCode code_;
};

/// Most bytes of data in a node (ZooKeeper's limit, less what its protocol adds).
inline constexpr std::size_t max_node_size = 1'000'000;

/// A node as it was read.
struct Node {
  std::string data;
  std::int64_t version = 0;      ///< counts changes of the data
  std::int64_t created = 0;      ///< order of creation in the whole registry (ZooKeeper's czxid)
  std::int64_t modified_ms = 0;  ///< when the data was written, in the server's wall time: no client can choose it
  bool ephemeral = false;
  std::int64_t owner_session = 0;  ///< owner of an ephemeral node
};

/// A node on which a write depends. The server checks it atomically with the write. So a write that was delayed on its
/// way (its process stood still, say) takes no effect if the node is gone by then.
struct Fence {
  std::string path;  ///< the write takes effect only while this node is there, else it is `fenced`; empty: always
};

/// The state of this process's session with the registry.
enum class SessionState {
  connecting,  ///< no connection now: the server keeps watches and held nodes until the session expires
  connected,
  expired,  ///< the server dropped the session; held nodes are gone and come back with the next `connected`
  closed,
};

/// Keeps something alive until it is destroyed: a watch, a held node, a listener. Its own callback may destroy it;
/// otherwise the destructor returns when the callback no longer runs.
class Guard {
 public:
  virtual ~Guard() = default;
};
using GuardPtr = std::unique_ptr<Guard>;

/// A tree of small nodes that all processes share (ZooKeeper's model). Paths are absolute, UTF-8, without "." and "..".
/// Thread safe. Calls wait for the answer, at most for the operation time-out, and throw RegistryError; callbacks may
/// make them. Callbacks run one at a time on the registry's own dispatcher thread, never inside a call.
class Registry {
 public:
  virtual ~Registry() = default;

  /// Creates a persistent node; with `parents`, missing parents too (empty, persistent).
  virtual void create(const std::string& path, const std::string& data, bool parents = true,
                      const Fence& fence = {}) = 0;
  /// \param expected_version -1 = any.
  virtual void set(const std::string& path, const std::string& data, std::int64_t expected_version = -1,
                   const Fence& fence = {}) = 0;
  virtual std::optional<Node> get(const std::string& path) = 0;  ///< nullopt: no such node
  /// \return false if there is no such node.
  virtual bool remove(const std::string& path, std::int64_t expected_version = -1, const Fence& fence = {}) = 0;
  virtual std::optional<std::vector<std::string>> children(const std::string& path) = 0;  ///< sorted names
  /// Makes many reads in little more than the time of one; answers are in the order of `paths`.
  virtual std::vector<std::optional<Node>> get_all(const std::vector<std::string>& paths) = 0;
  virtual std::vector<std::optional<std::vector<std::string>>> children_of_all(
      const std::vector<std::string>& paths) = 0;
  /// As get_all() and children_of_all(), but what this user may not read counts as absent, and the log tells of it: the
  /// thief of one process may shut others out of that process's nodes, not keep them from reading the rest.
  virtual std::vector<std::optional<Node>> get_readable(const std::vector<std::string>& paths) {
    return get_all(paths);
  }
  virtual std::vector<std::optional<std::vector<std::string>>> children_of_readable(
      const std::vector<std::string>& paths) {
    return children_of_all(paths);
  }

  /// Creates an ephemeral node (missing parents are made persistent) and keeps it: it is created again after the
  /// session expired, and removed when the guard is destroyed. With `sequential` the server appends ten digits that
  /// grow. Only a failure of the first creation is thrown. \param on_created gets the real path after each creation;
  /// may be empty.
  virtual GuardPtr hold(const std::string& path, const std::string& data, bool sequential = false,
                        std::function<void(const std::string& real_path)> on_created = {}) = 0;
  /// Like hold(), but returns at once: the node is created as soon as the registry is reachable and permits it, and
  /// when no other session's node (that of a dead process, say) is at the path any more.
  /// \throws RegistryError bad_path, too_large.
  virtual GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential = false,
                                   std::function<void(const std::string& real_path)> on_created = {}) = 0;

  /// Calls back with the node (nullopt: it does not exist) soon, and after every change until the guard is destroyed.
  /// Fast changes are merged: the last state is always reported. While the registry is away nothing is reported.
  virtual GuardPtr watch_node(const std::string& path, std::function<void(const std::optional<Node>&)> callback) = 0;
  /// Like watch_node(), for the sorted names of the children (nullopt: no such node).
  virtual GuardPtr watch_children(const std::string& path,
                                  std::function<void(const std::optional<std::vector<std::string>>&)> callback) = 0;

  virtual SessionState session() const = 0;
  /// Calls back with the state soon, and after every change.
  virtual GuardPtr on_session(std::function<void(SessionState)> callback) = 0;

  /// Calls back once, after `pause` at the earliest, and after all callbacks that are queued by then. So many callbacks
  /// can leave their common work to one call.
  virtual GuardPtr after(std::chrono::milliseconds pause, std::function<void()> callback) = 0;
};

class RegistryAccess;

/// How to reach the registry, and as which user.
struct RegistryOptions {
  /// "embedded://NAME" (the in-process registry of that name) or "zookeeper://host:port,host:port[/chroot]".
  std::string url;
  std::chrono::milliseconds session_timeout{10000};
  std::chrono::milliseconds operation_timeout{10000};
  /// This process's identity at ZooKeeper (digest authentication): its nodes belong to it, and only clients with the
  /// same user and password may use them. Empty: everybody may do everything with its nodes, which is refused for
  /// servers that other machines can reach.
  std::string user{};
  std::string password{};
  /// The permissions of a fleet's other users for the nodes that this process creates; `user` is one of them. Null:
  /// only clients with the same user and password may use them.
  std::shared_ptr<const RegistryAccess> access{};
  /// Clients without that password may read this process's nodes.
  bool others_may_read = false;
  /// The configuration says that a ZooKeeper without users, to which every process of this machine may write, is
  /// wanted: the log does not warn of it.
  bool open = false;
  /// The configuration says that something else protects the way to a ZooKeeper on another machine, to which this
  /// client sends everything, the user's password too, without TLS.
  bool unencrypted = false;
};

/// Returns at once and connects in the background, without a limit in time. \throws config::Error for a malformed URL,
/// and for a server of another machine without a user. Warns of one on this machine without a user.
std::unique_ptr<Registry> make_registry(const RegistryOptions& options);

struct Paths;
/// What renew_rights() has done.
struct RenewedRights {
  std::size_t nodes = 0;    ///< that were looked at
  std::size_t changed = 0;  ///< of them, those that had other rights
  /// Nodes whose rights kept masters out: whoever made them left out the fleet's rule. Those with nothing below are
  /// removed; their owners, if they are the fleet's, make them again.
  std::vector<std::string> removed;
  std::vector<std::string> foreign;  ///< of them, those that have nodes below; only ZooKeeper's superuser removes them
  /// ZooKeeper's own nodes that everybody who reaches it may still change: ServersNodes.
  std::vector<std::string> open;
  std::vector<std::string> seized;  ///< of its own nodes, those whose rights keep this master out
};
/// What renew_rights() does about nodes that ZooKeeper has from its beginning: `/`, `/zookeeper` and, with all below,
/// `/zookeeper/quota`. Whoever reaches the server may make nodes there and set quotas, until somebody takes these
/// rights away. Afterwards only masters may, so others who make nodes at the top must have their own by then, as a
/// chroot.
enum class ServersNodes { only_looked_at, closed };
/// Gives all nodes of a fleet in ZooKeeper the rights that `options.access` says now: a node keeps those of its
/// creation until somebody does, so a user that was added later may not enter, and one that was removed still may.
/// Makes the branches that are missing.
/// Waits for the registry's answers. A second run goes on where one ended early. The last thing it does is what
/// `servers` says.
/// \param options a master's, with user and access.
/// \param progress called now and then; may be empty.
/// \throws config::Error when the registry does not answer, or does not let this user change a node's rights; for an
/// embedded registry, which has no rights
RenewedRights renew_rights(const RegistryOptions& options, const Paths& paths,
                           const std::function<void(std::size_t nodes)>& progress = {},
                           ServersNodes servers = ServersNodes::only_looked_at);

/// Makes the nodes below which all records are (Paths::branches), as far as they are missing; masters do so whenever
/// they have reached the registry, which may have been emptied meanwhile, and when somebody has removed one. With
/// RegistryAccess nobody else may. Returns at once; the log tells what a master could not make or may not read.
/// \return ends it when it is destroyed
GuardPtr keep_branches(Registry& registry, const Paths& paths);

/// Sets a node's data; creates the node and its parents if they are missing.
void put(Registry& registry, const std::string& path, const std::string& data, const Fence& fence = {});
/// Removes a node and everything below it; missing nodes are no error.
void remove_tree(Registry& registry, const std::string& path, const Fence& fence = {});

/// The rule by which the next leader is chosen.
enum class Succession {
  longest_standing,  ///< each member has a node below `path`; the oldest leads
  /// The leader's node is `path` itself; when it is gone, the first to create it leads. One write and one read for each
  /// leader, and nothing stays behind: for thousands of elections with a member or two each.
  whoever_is_first,
};

/// The proof of leadership that a leader adds to its writes.
struct Lead {
  std::int64_t epoch = 0;  ///< as told to Election::Callbacks::on_elected
  Fence fence;             ///< is gone before another member leads
};

/// Leader election at `path`: at most one member leads at a time. All members must use the same succession. Callbacks
/// run on the registry's dispatcher. A member loses leadership when its session may be over (disconnected for longer
/// than the session's time-out, or expired); it then stands for election again by itself. A member whose node outlived
/// the interruption leads again under the same epoch: nobody else can have led meanwhile.
class Election {
 public:
  struct Callbacks {
    /// \param epoch grows with every leader of this path: the fencing number of its orders.
    std::function<void(std::int64_t epoch)> on_elected;
    std::function<void()> on_lost;
  };
  /// \param data what others see in this member's node (host:port, say); each member needs its own.
  /// Returns at once, even if the registry is away.
  Election(Registry& registry, std::string path, std::string data, Callbacks callbacks,
           Succession succession = Succession::longest_standing);
  ~Election();
  bool leading() const;
  /// nullopt: this member does not lead. Always nullopt with whoever_is_first: there the next leader's node has the
  /// same path, so its existence does not show who leads.
  std::optional<Lead> lead() const;
  /// Data of the current leader, as far as the registry tells; empty if there is none.
  std::string leader_data() const;

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::discovery
