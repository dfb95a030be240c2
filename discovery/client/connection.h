#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

/// Outcome of one operation at the server.
enum class ReplyStatus {
  ok,
  no_node,
  exists,
  not_empty,
  bad_version,
  bad_path,  ///< a child of an ephemeral node, or a path that the server refuses
  denied,    ///< the node belongs to another user
  fenced,    ///< the write's fence is gone; takes precedence over the other reasons
  away,      ///< the connection or the session was lost: whether a write took effect is unknown
};

struct Reply {
  ReplyStatus status = ReplyStatus::away;
  Node node;                       ///< set by get
  std::string path;                ///< set by create without a fence: the real path
  std::vector<std::string> names;  ///< set by children, sorted
};
using Done = std::function<void(Reply)>;

/// A sequence of sessions with a registry's server: the narrow interface between the client and an implementation of
/// the registry, modelled on ZooKeeper's protocol. Operations are asynchronous and take effect in the order in which
/// one thread makes them. `done` is called exactly once, possibly before the operation returns, and must neither block
/// nor call the connection; the same holds for the events. Thread safe, but only one thread may call `open`, `renew`,
/// `ask_for_new` and `ask_no_more`.
class RegistryConnection {
 public:
  struct Events {
    /// The client is connected: in a new session, or in the old one again. \param timeout as agreed with the server.
    std::function<void(std::int64_t session, std::chrono::milliseconds timeout)> connected;
    std::function<void()> disconnected;
    /// The server has dropped the session; no event follows until renew().
    std::function<void()> expired;
    /// A watch fired: the node at `path`, or its list of children, changed. Once for each read with `watch`.
    std::function<void(const std::string& path)> changed;
  };

  virtual ~RegistryConnection() = default;  ///< ends the session; no event or `done` comes afterwards

  /// Starts to connect, without a limit in time. \return false if it cannot even start (an unknown host name, say);
  /// call renew() later.
  virtual bool open(Events events) = 0;
  /// After `expired`, or when the server will not take the old session back: starts a new session. May take seconds (to
  /// look up a host's name). \return as open().
  virtual bool renew() = 0;
  /// Asks, without a limit in time, whether a server takes new sessions, whatever becomes of this one. A server whose
  /// state was emptied or put back takes no client that has seen a later state, and does not tell it so. `serves` is
  /// called at most once, as an event is. \return as open().
  virtual bool ask_for_new(std::function<void()> serves) = 0;
  /// Ends the question, if there is one; `serves` is not called any more.
  virtual void ask_no_more() = 0;
  /// How long after `disconnected` the session certainly still lives, if the server hears nothing.
  virtual std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const = 0;
  /// How long an attempt to come back may take at a server that accepts it and says nothing (it was just starting,
  /// say).
  virtual std::chrono::milliseconds longest_attempt(std::chrono::milliseconds timeout) const = 0;

  virtual void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential,
                      const Fence& fence, Done done) = 0;
  virtual void set(const std::string& path, const std::string& data, std::int64_t expected_version, const Fence& fence,
                   Done done) = 0;
  virtual void remove(const std::string& path, std::int64_t expected_version, const Fence& fence, Done done) = 0;
  /// With `watch`, `changed(path)` follows once when the node changes, is removed, or, if it does not exist, is
  /// created.
  virtual void get(const std::string& path, bool watch, Done done) = 0;
  /// With `watch`, `changed(path)` follows once when children are created or removed, or the node itself is.
  virtual void children(const std::string& path, bool watch, Done done) = 0;
};

}  // namespace iotcloud::discovery
