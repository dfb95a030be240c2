#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/placement/reading_group.h>
#include <iotcloud/topology/endpoints/placement/task_loads.h>
#include <iotcloud/topology/endpoints/receiving/channel_reader.h>
#include <iotcloud/topology/endpoints/receiving/verdicts.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Finds the channels that one spout component reads, and places them on its tasks; one object for each component and
/// worker. The unit of placement is a driver instance (exclusive channels) or a driver on a gateway (shared ones).
///
/// Each worker of the group (`group`, or else the topology) stands for election for its fair share of the units, so
/// that over all tasks of all workers nobody has more than one unit more than another, of either kind and in all; the
/// election lets a unit have one reader, and the broker's exclusive consumer makes sure of it. A unit that moves is
/// drained before. While the registry is away nothing moves and reading goes on. Thread safe.
class SpoutPlacement {
 public:
  SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);
  ~SpoutPlacement();

  /// A task is open. With the last of `task_count` the search begins.
  void join(int task_index, int task_count, std::shared_ptr<Inbox> inbox);
  /// A task closes: with the first one everything ends. Returns when nothing comes any more.
  void leave();
  /// Whom `where` chooses, also among those that share a channel.
  std::shared_ptr<const Verdicts> verdicts() const { return verdicts_; }

 private:
  using ReaderKey = std::pair<brokers::BrokerAddress, brokers::Topic>;
  /// A unit that moves is read here but takes nothing in any more, until what it brought is settled or drain_limit is
  /// over; then it is read there.
  enum class Move { none, to_task, to_worker };
  static constexpr std::chrono::milliseconds look_period{10}, drain_limit{2000};
  struct Unit {
    UnitKind kind = UnitKind::instance;
    std::map<std::string, discovery::ChannelRecord> channels;  ///< by driver instance
    std::unique_ptr<discovery::Election> election;             ///< null: another worker's share
    bool leads = false;
    bool frozen = false;  ///< leadership was lost with the registry: reading goes on until it is back
    int task = -1;        ///< -1: not read here
    Move move = Move::none;
    int looks_left = 0;  ///< while it moves
    std::map<ReaderKey, std::shared_ptr<ChannelReader>> readers;
  };
  struct Search;  ///< the watches

  /// Runs a callback of the registry, unless everything is over.
  template <typename Function>
  void in_turn(Function function) {
    std::vector<std::unique_ptr<discovery::Election>> dying;  // outside the lock: they wait for their callbacks
    const std::lock_guard lock(mutex_);
    if (over_) return;
    function();
    dying.swap(resigned_);
  }

  // From here on with mutex_ held, on the registry's dispatcher.
  void on_channel(const discovery::ChannelRecord& channel);
  void on_channel_gone(const discovery::ChannelRecord& channel);
  void on_sharers(const std::vector<Sharer>& sharers, const std::string& problem);
  void on_elected(const std::string& unit);
  void on_lost(const std::string& unit);
  void on_session(discovery::SessionState state);
  void subscribe_anew();
  bool fits(const discovery::ChannelRecord& channel);
  void share_out_soon();
  void share_out();
  void stand(const std::string& name, Unit& unit);
  void move(const std::string& name, Unit& unit, Move where);
  void look_soon();
  void look_at_moves();
  void release(const std::string& name, Unit& unit);
  void stop_reading(const std::string& name, Unit& unit);
  void close_readers(Unit& unit);
  void read(Unit& unit);
  void balance();
  std::shared_ptr<ChannelReader> open_reader(const discovery::ChannelRecord& channel, const ReaderKey& key, int task);
  void report();
  void tell_soon();
  bool alone() const { return sharers_.size() == 1 && sharers_.front().worker == services_->worker; }

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;
  const std::shared_ptr<Verdicts> verdicts_ = std::make_shared<Verdicts>();

  std::string path_;  ///< of the group's records; set by the last join()

  std::mutex mutex_;
  std::map<int, std::shared_ptr<Inbox>> inboxes_;               ///< by task index; guarded by mutex_
  bool over_ = false;                                           ///< guarded by mutex_
  std::vector<Sharer> sharers_;                                 ///< empty: not known yet; guarded by mutex_
  std::map<std::string, Unit> units_;                           ///< guarded by mutex_
  std::set<std::string> complained_;                            ///< guarded by mutex_
  TaskLoads loads_;                                             ///< guarded by mutex_
  std::size_t reader_count_ = 0;                                ///< guarded by mutex_
  std::vector<std::unique_ptr<discovery::Election>> resigned_;  ///< of released units; guarded by mutex_
  bool sharing_soon_ = false;                                   ///< share_out() will be called; guarded by mutex_
  discovery::GuardPtr anew_;                                    ///< calls subscribe_anew(); guarded by mutex_
  discovery::GuardPtr sharing_;                                 ///< that call; guarded by mutex_
  std::set<std::string> moving_;                                ///< units; guarded by mutex_
  bool looking_soon_ = false;                                   ///< look_at_moves() will be called; guarded by mutex_
  discovery::GuardPtr looking_;                                 ///< that call; guarded by mutex_
  std::size_t taken_ = 0, given_up_ = 0;                        ///< units, since the log told; guarded by mutex_
  bool telling_soon_ = false;                                   ///< the log will be told; guarded by mutex_
  discovery::GuardPtr telling_;                                 ///< that call; guarded by mutex_
  std::string problem_;                                         ///< why there is no share here; guarded by mutex_
  std::unique_ptr<Search> search_;                              ///< set by the last join(), taken by the first leave()
};

}  // namespace iotcloud::topology
