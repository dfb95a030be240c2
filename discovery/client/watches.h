#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include <iotcloud/discovery/client/callback.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/client/serial_thread.h>

namespace iotcloud::discovery {

using NodeCallback = Callback<std::optional<Node>>;
using ChildrenCallback = Callback<std::optional<std::vector<std::string>>>;

/// One watch: `on_node` or `on_children` is set.
struct Watch {
  std::string path;
  std::shared_ptr<NodeCallback> on_node;
  std::shared_ptr<ChildrenCallback> on_children;

  void shut();

 private:
  friend class Watches;
  bool removed = false;
  bool reading = false;    ///< an answer is under way
  bool again = false;      ///< something changed meanwhile
  bool scheduled = false;  ///< a read is due at a later time
  bool complained = false;
  SerialThread::Instant last_read = SerialThread::Instant::min();
  std::optional<Reply> reported;
};

/// Makes lasting watches of the server's one-shot ones: after each change it reads again, which sets the next one.
/// The first change is read at once; further ones wait for a few milliseconds, so that many become one.
/// All methods run on the worker.
class Watches {
 public:
  Watches(Connection& connection, SerialThread& worker, SerialThread& dispatcher)
      : connection_(connection), worker_(worker), dispatcher_(dispatcher) {}

  void add(std::shared_ptr<Watch> watch);
  void remove(const std::shared_ptr<Watch>& watch);
  /// Everything is read again: what changed meanwhile is reported.
  void connected();
  void disconnected() { connected_ = false; }
  void changed(const std::string& path);

 private:
  using WatchPtr = std::shared_ptr<Watch>;
  void touch(const WatchPtr& watch);
  void schedule(const WatchPtr& watch, SerialThread::Instant when);
  void read(const WatchPtr& watch);
  void answered(const WatchPtr& watch, Reply reply);
  void report(Watch& watch, Reply reply);

  Connection& connection_;
  SerialThread& worker_;
  SerialThread& dispatcher_;
  bool connected_ = false;
  std::unordered_multimap<std::string, WatchPtr> watches_;  ///< by path
};

}  // namespace iotcloud::discovery
