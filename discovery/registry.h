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
  exists,       ///< create: it is there already
  not_empty,    ///< remove: it has children
  bad_version,  ///< set or remove: it was changed meanwhile
  bad_path,     ///< not of the form /a/b/c, or a child of an ephemeral node
  away,         ///< no connection within the time-out: whether a write took effect is unknown
  closed,       ///< the registry object was closed
  too_large,    ///< more data than a node takes (max_node_size)
  denied,       ///< the node belongs to others: RegistryOptions::user
  fenced,       ///< the write's fence is gone: Fence
};

class RegistryError : public config::Error {
 public:
  RegistryError(RegistryErrorCode code, const std::string& text) : Error(text), code_(code) {}
  RegistryErrorCode code() const { return code_; }

 private:
  RegistryErrorCode code_;
};

/// Bytes of data that a node takes (ZooKeeper's limit, less what its protocol adds).
inline constexpr std::size_t max_node_size = 1'000'000;

struct Node {
  std::string data;
  std::int64_t version = 0;  ///< counts changes of the data
  std::int64_t created = 0;  ///< order of creation in the whole registry (ZooKeeper's czxid)
  bool ephemeral = false;
  std::int64_t owner_session = 0;  ///< of an ephemeral node
};

/// What a write depends on. The server decides that in one step with the write, so one that was held up on its way (its
/// process stood still, say) takes no effect when things have changed meanwhile.
struct Fence {
  std::string path;  ///< the write takes effect only while this node is there, else it is `fenced`; empty: always
};

enum class SessionState {
  connecting,  ///< away for now: watches and held nodes are kept by the server until the session expires
  connected,
  expired,  ///< the server dropped the session; held nodes are gone and come back with the next `connected`
  closed,
};

/// Keeps something alive until destroyed: a watch, a held node, a listener. Destroying it from inside its own callback
/// is allowed; otherwise its destructor returns when the callback does not run any more.
class Guard {
 public:
  virtual ~Guard() = default;
};
using GuardPtr = std::unique_ptr<Guard>;

/// A tree of small nodes that all processes share (ZooKeeper's model). Paths are absolute, UTF-8, without "." and "..".
/// Thread safe. Calls wait for the answer, at most the operation time-out, and throw RegistryError; they may be made
/// from callbacks. Callbacks run one at a time on the registry's own dispatcher thread, never inside a call.
class Registry {
 public:
  virtual ~Registry() = default;

  /// Creates a persistent node. With `parents`, missing parents too (empty, persistent).
  virtual void create(const std::string& path, const std::string& data, bool parents = true,
                      const Fence& fence = {}) = 0;
  /// \param expected_version -1 = any.
  virtual void set(const std::string& path, const std::string& data, std::int64_t expected_version = -1,
                   const Fence& fence = {}) = 0;
  virtual std::optional<Node> get(const std::string& path) = 0;  ///< nullopt: no such node
  /// \return false when there is no such node.
  virtual bool remove(const std::string& path, std::int64_t expected_version = -1, const Fence& fence = {}) = 0;
  virtual std::optional<std::vector<std::string>> children(const std::string& path) = 0;  ///< sorted names
  /// Many reads in little more than the time of one; the answers stand in the order of `paths`.
  virtual std::vector<std::optional<Node>> get_all(const std::vector<std::string>& paths) = 0;
  virtual std::vector<std::optional<std::vector<std::string>>> children_of_all(
      const std::vector<std::string>& paths) = 0;

  /// Creates an ephemeral node (parents persistent, made when missing) and keeps it: it is created again after the
  /// session expired, and removed when the guard dies. With `sequential` the server appends ten digits that grow. Only
  /// the first creation throws. \param on_created gets the real path after each creation; may be empty.
  virtual GuardPtr hold(const std::string& path, const std::string& data, bool sequential = false,
                        std::function<void(const std::string& real_path)> on_created = {}) = 0;
  /// The same, but returns at once: the node is created as soon as the registry is there
  /// and lets us, also while another session's node still stands in its place (that of a process which died).
  /// \throws RegistryError bad_path, too_large.
  virtual GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential = false,
                                   std::function<void(const std::string& real_path)> on_created = {}) = 0;

  /// Calls back with the node (nullopt: it is not there) soon, and after every change until the guard dies. Changes
  /// that come fast are seen as one: the last state is always reported. While the registry is away nothing is reported.
  virtual GuardPtr watch_node(const std::string& path, std::function<void(const std::optional<Node>&)> callback) = 0;
  /// The same for the sorted names of the children (nullopt: no such node).
  virtual GuardPtr watch_children(const std::string& path,
                                  std::function<void(const std::optional<std::vector<std::string>>&)> callback) = 0;

  virtual SessionState session() const = 0;
  /// Calls back with the state soon, and after every change.
  virtual GuardPtr on_session(std::function<void(SessionState)> callback) = 0;

  /// Calls back once, no sooner than after `pause`, behind the callbacks that wait already: for work that is done once
  /// for many of them.
  virtual GuardPtr after(std::chrono::milliseconds pause, std::function<void()> callback) = 0;
};

struct RegistryOptions {
  /// "embedded://NAME" (the in-process registry of that name) or "zookeeper://host:port,host:port[/chroot]".
  std::string url;
  std::chrono::milliseconds session_timeout{10000};
  std::chrono::milliseconds operation_timeout{10000};
  /// Who this process is to ZooKeeper (digest authentication): what it creates is its own, and others with the same
  /// user and password may use it. Empty: everybody may do everything with what it creates.
  std::string user{};
  std::string password{};
  /// Clients without that password may read what this process creates.
  bool others_may_read = false;
};

/// Returns at once and connects in the background, for ever. \throws config::Error for a URL that cannot be read.
std::unique_ptr<Registry> make_registry(const RegistryOptions& options);

/// Sets the data of a node, creating it and its parents when missing.
void put(Registry& registry, const std::string& path, const std::string& data, const Fence& fence = {});
/// Removes a node and all below it; what is gone already is no error.
void remove_tree(Registry& registry, const std::string& path, const Fence& fence = {});

/// Who follows a leader.
enum class Succession {
  longest_standing,  ///< each member has a node below `path`, and they follow in the order of their coming
  /// The leader's node is `path` itself, and who creates it first when it is gone leads. One write and one read for
  /// each leader, and nothing stays behind: for thousands of elections with a member or two each.
  whoever_is_first,
};

/// What a leader's writes carry.
struct Lead {
  std::int64_t epoch = 0;  ///< as told to Election::Callbacks::on_elected
  Fence fence;             ///< is gone before another one leads
};

/// Leader election at `path`: of all members exactly one leads at a time. They agree about the succession.
/// Callbacks run on the registry's dispatcher. Leadership is lost when the session is no longer certain to live
/// (disconnected for longer than the session's time-out, or expired); the member stands again by itself. One whose node
/// outlived the interruption leads again under the same epoch: nobody else can have led meanwhile.
class Election {
 public:
  struct Callbacks {
    /// \param epoch grows with every leader of this path: the fencing number of its orders.
    std::function<void(std::int64_t epoch)> on_elected;
    std::function<void()> on_lost;
  };
  /// \param data what others see in this member's node (host:port, say); each member's is another.
  /// Returns at once, whether the registry is there or not.
  Election(Registry& registry, std::string path, std::string data, Callbacks callbacks,
           Succession succession = Succession::longest_standing);
  ~Election();
  bool leading() const;
  /// nullopt: it does not lead; always so where whoever is first leads, because there the next one's node has the same
  /// path and is no fence.
  std::optional<Lead> lead() const;
  /// Data of the member that leads now, as far as the registry tells; empty when none.
  std::string leader_data() const;

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::discovery
