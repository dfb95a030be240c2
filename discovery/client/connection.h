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
enum class Status {
  ok,
  no_node,
  exists,
  not_empty,
  bad_version,
  bad_path,  ///< a child of an ephemeral node, or a path that the server refuses
  denied,    ///< the node belongs to others
  fenced,    ///< a write whose fence is gone; goes before the other reasons
  away,      ///< the connection or the session went: whether a write took effect is unknown
};

struct Reply {
  Status status = Status::away;
  Node node;                       ///< get
  std::string path;                ///< create without a fence: the real path
  std::vector<std::string> names;  ///< children, sorted
};
using Done = std::function<void(Reply)>;

/// One session after another with a registry's server: the narrow seam below RegistryClient, modelled on ZooKeeper's
/// protocol. Operations are asynchronous and take effect in the order in which one thread makes them; `done` is called
/// exactly once, possibly before the operation returns, and must neither block nor call the connection. The same holds
/// for the events. Thread safe, but `open` and `renew` are called by one thread only.
class Connection {
 public:
  struct Events {
    /// The session lives: a new one, or the same one reached again. \param timeout as agreed with the server.
    std::function<void(std::int64_t session, std::chrono::milliseconds timeout)> connected;
    std::function<void()> disconnected;
    /// The server has dropped the session; nothing more happens until renew().
    std::function<void()> expired;
    /// A watch fired: what stands at `path`, or below it, changed. Once for each read with `watch`.
    std::function<void(const std::string& path)> changed;
  };

  virtual ~Connection() = default;  ///< ends the session; no event or `done` comes afterwards

  /// Starts to connect, for ever. \return false when not even that is possible now (the host's name is not known, say);
  /// call renew() later.
  virtual bool open(Events events) = 0;
  /// After `expired`: starts a new session. May take seconds (a host's name is looked up). \return as open().
  virtual bool renew() = 0;
  /// How long after `disconnected` the session is certain to live still, when the server hears nothing.
  virtual std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const = 0;

  virtual void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential,
                      const Fence& fence, Done done) = 0;
  virtual void set(const std::string& path, const std::string& data, std::int64_t expected_version, const Fence& fence,
                   Done done) = 0;
  virtual void remove(const std::string& path, std::int64_t expected_version, const Fence& fence, Done done) = 0;
  /// With `watch`, `changed(path)` follows once when the node changes, goes, or comes if it is not there.
  virtual void get(const std::string& path, bool watch, Done done) = 0;
  /// With `watch`, `changed(path)` follows once when children come or go, or the node itself does.
  virtual void children(const std::string& path, bool watch, Done done) = 0;
};

}  // namespace iotcloud::discovery
