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

/// Sorted names, shared by all watches that get them; nullopt: no such node.
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
  bool told = false;  ///< the callback got at least one state
};

/// Turns the server's one-shot watches into lasting ones: after each change it reads again, which sets the next watch.
/// It reads the first change at once; further changes wait for a few milliseconds and are read together. Several
/// watches of one path share a read. All methods run on the worker thread.
class Watches {
 public:
  Watches(RegistryConnection& connection, SerialThread& worker, SerialThread& dispatcher)
      : connection_(connection), worker_(worker), dispatcher_(dispatcher) {}

  void add(const std::shared_ptr<Watch>& watch);
  void remove(const std::shared_ptr<Watch>& watch);
  /// Reads everything again and reports what changed meanwhile.
  void connected();
  void disconnected() { connected_ = false; }
  void changed(const std::string& path);

 private:
  using WatchPtr = std::shared_ptr<Watch>;

  /// The shared state of all watches of one kind on one path.
  struct Place {
    std::string path;
    bool lists_children = false;
    std::vector<WatchPtr> watches;  ///< empty: nobody watches the path any more
    bool reading = false;           ///< a read was sent and is not answered yet
    bool again = false;             ///< something changed after that read was sent
    bool scheduled = false;         ///< a read is scheduled
    bool complained = false;
    SerialThread::Instant last_read = SerialThread::Instant::min();
    // The state that was reported last; without a status nothing was reported yet. `version`, `created` and a hash of
    // the data show whether a node has changed: a server that was emptied counts versions and creations anew.
    std::optional<ReplyStatus> status;
    std::int64_t version = 0;
    std::int64_t created = 0;
    std::size_t data_hash = 0;
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

  RegistryConnection& connection_;
  SerialThread& worker_;
  SerialThread& dispatcher_;
  bool connected_ = false;
  Places nodes_;  ///< by path
  Places lists_;  ///< of children, by path
};

}  // namespace iotcloud::discovery
