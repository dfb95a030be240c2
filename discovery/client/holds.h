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

/// An ephemeral node that the client creates again whenever it is lost, until its guard is destroyed.
struct Hold {
  std::string path;
  std::string data;
  bool sequential = false;
  std::shared_ptr<Callback<std::string>> on_created;
  /// Called on the worker with the outcome of the first attempt to create the node. If this function is set, a refused
  /// first attempt is not repeated; if it is empty, attempts go on until one succeeds.
  std::function<void(ReplyStatus)> first_answer;

 private:
  friend class Holds;
  bool released = false;      ///< the guard is destroyed
  bool busy = false;          ///< an operation is under way or scheduled
  std::string real_path;      ///< empty: not created, as far as we know
  std::int64_t session = 0;   ///< the session of the node, or of the creation in doubt
  bool in_doubt = false;      ///< the answer to a creation in `session` was lost
  bool parent_known = false;  ///< the parent existed a moment ago
  bool suspect = false;       ///< somebody changed or removed the node: it may belong to another session now
  bool complained = false;    ///< the log has said that the node cannot be created
};

/// Keeps ephemeral nodes: creates them again in every new session, finds out whether a creation took place whose answer
/// was lost (a node that our session owns and that has the hold's data is ours), and removes them when they are
/// released, whatever happened before. All methods run on the worker.
class Holds {
 public:
  Holds(RegistryConnection& connection, SerialThread& worker, SerialThread& dispatcher)
      : connection_(connection), worker_(worker), dispatcher_(dispatcher) {}

  void add(const std::shared_ptr<Hold>& hold);
  void release(const std::shared_ptr<Hold>& hold);
  void connected(std::int64_t session);
  /// A watch fired: another session's node at a hold's path may be gone, or a held node may belong to another session
  /// now.
  void changed(const std::string& path);
  void disconnected() { connected_ = false; }

 private:
  using HoldPtr = std::shared_ptr<Hold>;
  void step(const HoldPtr& hold);
  void step_later(const HoldPtr& hold, std::chrono::milliseconds pause);
  void create(const HoldPtr& hold);
  void created(const HoldPtr& hold, const Reply& reply);
  void settle(const HoldPtr& hold, const std::string& real_path);
  void refused(const HoldPtr& hold, ReplyStatus status);
  void wait_for_place(const HoldPtr& hold);
  void remove(const HoldPtr& hold);
  void remove_own(const HoldPtr& hold);
  void let_through(const std::string& parent);
  void resolve_doubt(const HoldPtr& hold);
  void look_at(const HoldPtr& hold, std::vector<std::string> candidates);
  void make_parents(const std::string& path, const std::function<void(ReplyStatus)>& next);
  bool taken(const std::string& real_path) const { return taken_.contains(real_path); }
  void forget_node(const HoldPtr& hold);
  /// Makes a callback that runs `next` with the answer on the worker.
  Done on_worker(std::function<void(Reply)> next);

  RegistryConnection& connection_;
  SerialThread& worker_;
  SerialThread& dispatcher_;
  bool connected_ = false;
  std::int64_t session_ = 0;
  std::set<HoldPtr> holds_;
  std::map<std::string, HoldPtr> taken_;         ///< by real path: this session's nodes that belong to holds
  std::multimap<std::string, HoldPtr> waiting_;  ///< by path: holds that wait until another node at their path is gone
  /// By parent: holds that wait until the first creation below it has found or made the parent for all of them.
  std::map<std::string, std::vector<HoldPtr>> behind_;
};

}  // namespace iotcloud::discovery
