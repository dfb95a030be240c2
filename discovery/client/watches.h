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

/// Sorted names, shared by all who are told of them; nullopt: no such node.
using SharedNames = std::shared_ptr<const std::optional<std::vector<std::string>>>;
using NodeCallback = Callback<std::optional<Node>>;
using ChildrenCallback = Callback<SharedNames>;

/// One watch: `on_node` or `on_children` is set.
struct Watch {
  std::string path;
  std::shared_ptr<NodeCallback> on_node;
  std::shared_ptr<ChildrenCallback> on_children;

  void shut();

 private:
  friend class Watches;
  bool told = false;  ///< once at least
};

/// Makes lasting watches of the server's one-shot ones: after each change it reads again, which sets the next one.
/// The first change is read at once; further ones wait for a few milliseconds, so that many become one. What several
/// watch is read once for all of them.
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

  /// What is read for all watches of one kind on one path.
  struct Place {
    std::string path;
    bool lists_children = false;
    std::vector<WatchPtr> watches;  ///< none: it is over
    bool reading = false;           ///< an answer is under way
    bool again = false;             ///< something changed meanwhile
    bool scheduled = false;         ///< a read is due at a later time
    bool complained = false;
    SerialThread::Instant last_read = SerialThread::Instant::min();
    // As it was told last; nothing yet when there is no status. Of a node the version suffices to see a change.
    std::optional<Status> status;
    std::int64_t version = 0;
    std::int64_t created = 0;
    SharedNames names;
  };
  using PlacePtr = std::shared_ptr<Place>;
  using Places = std::unordered_map<std::string, PlacePtr>;

  Places& places_of(const Watch& watch) { return watch.on_node ? nodes_ : lists_; }
  void touch(const PlacePtr& place);
  void schedule(const PlacePtr& place, SerialThread::Instant when);
  void read(const PlacePtr& place);
  void answered(const PlacePtr& place, Reply reply);
  void report(Place& place, Reply reply);

  Connection& connection_;
  SerialThread& worker_;
  SerialThread& dispatcher_;
  bool connected_ = false;
  Places nodes_;  ///< by path
  Places lists_;  ///< of children, by path
};

}  // namespace iotcloud::discovery
