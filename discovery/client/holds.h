#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/client/callback.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/client/serial_thread.h>

namespace iotcloud::discovery {

/// One held node.
struct Hold {
  std::string path;
  std::string data;
  bool sequential = false;
  std::shared_ptr<Callback<std::string>> on_created;
  /// Told of the first attempt's outcome, on the worker. When it is set, a first attempt that the server refuses is
  /// the last one; when it is empty, it is tried for ever.
  std::function<void(Status)> first_answer;

 private:
  friend class Holds;
  bool released = false;      ///< the guard is gone
  bool busy = false;          ///< an operation is under way, or due at a later time
  std::string real_path;      ///< empty: not created, as far as is known
  std::int64_t session = 0;   ///< of the node, or of the creation in doubt
  bool in_doubt = false;      ///< a creation in `session` was not answered
  bool parent_known = false;  ///< what it stands below was there a moment ago
  bool suspect = false;       ///< its node was changed or removed by somebody, and may be another's now
  bool complained = false;    ///< said in the log that it cannot be created
};

/// Keeps ephemeral nodes: creates them again in every new session, finds out about creations whose answer was lost
/// (the node is ours when our session owns it), and removes them when they are released, whatever happened before.
/// All methods run on the worker.
class Holds {
 public:
  Holds(Connection& connection, SerialThread& worker, SerialThread& dispatcher)
      : connection_(connection), worker_(worker), dispatcher_(dispatcher) {}

  void add(std::shared_ptr<Hold> hold);
  void release(const std::shared_ptr<Hold>& hold);
  void connected(std::int64_t session);
  /// A watch fired: the node that stood in somebody's way may be gone, or a held one be another's.
  void changed(const std::string& path);
  void disconnected() { connected_ = false; }

 private:
  using HoldPtr = std::shared_ptr<Hold>;
  void step(const HoldPtr& hold);
  void step_later(const HoldPtr& hold, std::chrono::milliseconds pause);
  void create(const HoldPtr& hold);
  void created(const HoldPtr& hold, const Reply& reply);
  void settle(const HoldPtr& hold, const std::string& real_path);
  void refused(const HoldPtr& hold, Status status);
  void wait_for_place(const HoldPtr& hold);
  void remove(const HoldPtr& hold);
  void remove_own(const HoldPtr& hold);
  void let_through(const std::string& parent);
  void resolve_doubt(const HoldPtr& hold);
  void look_at(const HoldPtr& hold, std::vector<std::string> candidates);
  void make_parents(const std::string& path, std::function<void(Status)> next);
  bool taken(const std::string& real_path) const { return taken_.contains(real_path); }
  void forget_node(const HoldPtr& hold);
  /// Brings the answer to the worker.
  Done on_worker(std::function<void(Reply)> next);

  Connection& connection_;
  SerialThread& worker_;
  SerialThread& dispatcher_;
  bool connected_ = false;
  std::int64_t session_ = 0;
  std::set<HoldPtr> holds_;
  std::map<std::string, HoldPtr> taken_;         ///< by real path: this session's nodes that holds have for their own
  std::multimap<std::string, HoldPtr> waiting_;  ///< by path, for the node that stands there to go
  /// By parent: those that wait until the first creation below it has found it, or made it, once for all.
  std::map<std::string, std::vector<HoldPtr>> behind_;
};

}  // namespace iotcloud::discovery
