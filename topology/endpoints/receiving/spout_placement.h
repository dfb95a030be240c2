#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/placement/reading_group.h>
#include <iotcloud/topology/endpoints/receiving/known_instances.h>
#include <iotcloud/topology/endpoints/receiving/prefetch_report.h>
#include <iotcloud/topology/endpoints/receiving/split_topics.h>
#include <iotcloud/topology/endpoints/receiving/spout_units.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Finds the channels that one spout component reads, and places them on its tasks. A worker has one object for each
/// such component. The unit of placement is a driver instance (exclusive channels) or a driver on a gateway (shared
/// channels); where the broker splits topics (Kafka), it is one partition of the latter. Partitions with the same
/// number of all channels of a driver on a gateway are one unit for all spouts, so that a driver's messages meet in one
/// worker; channels that come to one bolt and would not meet are not read (PartitionAgreement).
///
/// The workers of a group (YAML's `group`, or the workers of the topology) share the units: each runs for leader of
/// those of its fair share, so that the numbers of units of any two tasks differ by one at most, of each kind and in
/// all. Only a unit's leader reads it; the broker's exclusive consumer makes sure of that even if two workers believe
/// that they lead. A unit is drained before it moves. A unit whose last channel is gone (its drivers have stopped) is
/// read until nothing more comes, because what they sent before may still be at the broker. While the registry is away
/// no unit moves and reading goes on.
///
/// The units of all spouts of a driver are shared out together (DriverUnits), so that whichever channels a driver
/// instance has are read in one worker. A channel that few instances have may be spread less evenly for that. Where the
/// workers of a group have different spouts, each channel is shared out by itself: each worker must know all units of
/// which it leaves some to others.
/// Thread safe.
class SpoutPlacement {
 public:
  SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);
  ~SpoutPlacement();

  /// A task calls it when it opens. The call of the last of `task_count` tasks begins the search for channels.
  void join(int task_index, int task_count, std::shared_ptr<SpoutQueue> queue);
  /// A task calls it when it closes. The first call ends all reading, and returns when no message comes any more.
  void leave();
  /// The driver's instances, also those that share a channel.
  std::shared_ptr<const KnownInstances> known_instances() const { return known_instances_; }
  /// How old the messages are that the tasks receive, and how many more wait at the brokers.
  const std::shared_ptr<Arrivals>& arrivals() const { return arrivals_; }

 private:
  struct Search;  ///< all that tells what to read: session, reading group, drivers, fence
  /// The gateway of an instance whose channel is not read, and why.
  using Difference = std::pair<discovery::GatewayId, std::string>;

  /// Runs a callback of the registry, unless leave() was called. No lock is held meanwhile: the callback opens and
  /// closes readers, which may take long, and nobody but leave() waits for it.
  template <typename Function>
  void in_turn(Function function) {
    if (!begin_turn()) return;
    const TurnEnd end(*this);
    dispatcher_.assert_held();
    function();
    plan_what_follows();
    report();
    units_.take_resigned();  // destroyed here, at the end, because they wait for their callbacks
  }
  /// \return false: everything is over
  bool begin_turn() IOTCLOUD_EXCLUDES(mutex_);
  void end_turn() IOTCLOUD_EXCLUDES(mutex_);
  struct TurnEnd {
    explicit TurnEnd(SpoutPlacement& of) : placement(of) {}
    ~TurnEnd() { placement.end_turn(); }
    TurnEnd(const TurnEnd&) = delete;
    TurnEnd& operator=(const TurnEnd&) = delete;
    SpoutPlacement& placement;
  };
  std::shared_ptr<SpoutQueue> queue_of(int task) IOTCLOUD_EXCLUDES(mutex_);
  /// Plans `call` in a turn soon, unless that is planned already. Any thread may call it. \param timer
  /// after_fence_ or after_others_
  void plan_soon(discovery::GuardPtr SpoutPlacement::*timer, void (SpoutPlacement::*call)()) IOTCLOUD_EXCLUDES(mutex_);
  discovery::GuardPtr take(discovery::GuardPtr SpoutPlacement::*timer) IOTCLOUD_EXCLUDES(mutex_);

  // These functions run on the registry's dispatcher.
  void on_channel(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void place(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void add_to_unit(const discovery::ChannelRecord& channel, std::optional<std::int32_t> partition)
      IOTCLOUD_REQUIRES(dispatcher_);
  void displace(const discovery::ChannelRecord& channel, int first_partition, SpoutUnits::End end)
      IOTCLOUD_REQUIRES(dispatcher_);
  void follow_no_more(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  UnitReaders::Key key_of(const discovery::ChannelRecord& channel) const;
  void on_partitions() IOTCLOUD_REQUIRES(dispatcher_);
  void on_channel_gone(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void on_state(const discovery::InstanceId& instance, std::optional<discovery::DriverState> state)
      IOTCLOUD_REQUIRES(dispatcher_);
  void remove_queue(const UnitReaders::Key& topic) IOTCLOUD_REQUIRES(dispatcher_);
  void on_missing(const std::vector<discovery::ChannelRecord>& channels) IOTCLOUD_REQUIRES(dispatcher_);
  void warn_of_missing() IOTCLOUD_REQUIRES(dispatcher_);
  bool queues_are_empty() IOTCLOUD_EXCLUDES(mutex_);
  void on_shares(const ReadingGroup::Shares& shares) IOTCLOUD_REQUIRES(dispatcher_);
  void on_lost(const std::string& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void on_session(discovery::SessionState state) IOTCLOUD_REQUIRES(dispatcher_);
  bool fits(const discovery::ChannelRecord& channel, const std::string& unfit) IOTCLOUD_REQUIRES(dispatcher_);
  void set_difference(const discovery::ChannelRecord& channel, const std::string& text) IOTCLOUD_REQUIRES(dispatcher_);
  void show_difference(const Difference& difference) IOTCLOUD_REQUIRES(dispatcher_);
  discovery::GuardPtr run_for_leader(const std::string& unit);
  std::shared_ptr<TopicReader> open_reader(const discovery::ChannelRecord& channel, const UnitReaders::Key& key,
                                           std::optional<std::int32_t> partition, int task)
      IOTCLOUD_REQUIRES(dispatcher_);
  void show_missing() IOTCLOUD_REQUIRES(dispatcher_);
  void report() IOTCLOUD_REQUIRES(dispatcher_);
  /// Of this component's metrics.
  config::Labels labels() const { return {{"topology", services_->topology.str()}, {"component", component_}}; }

  /// A call that a timer of the registry makes.
  struct PlannedCall {
    bool made = false;  ///< and the call has not begun
    discovery::GuardPtr timer;
  };
  struct PlannedCalls {
    PlannedCall sharing, looking, telling, limit, arrivals, missing, reading, opening;
  };
  /// Plans a call, unless it is planned already.
  void plan(PlannedCall& plan, std::chrono::milliseconds pause, void (SpoutPlacement::*call)())
      IOTCLOUD_REQUIRES(dispatcher_);
  /// Plans the calls that the units need after what a callback did to them.
  void plan_what_follows() IOTCLOUD_REQUIRES(dispatcher_);
  void hold_back() IOTCLOUD_REQUIRES(dispatcher_);
  void read_anew() IOTCLOUD_REQUIRES(dispatcher_);
  void on_answer() IOTCLOUD_REQUIRES(dispatcher_);
  void open_missing() IOTCLOUD_REQUIRES(dispatcher_);
  void share_out() IOTCLOUD_REQUIRES(dispatcher_);
  void look() IOTCLOUD_REQUIRES(dispatcher_);
  void look_for_limit() IOTCLOUD_REQUIRES(dispatcher_);
  void look_at_arrivals() IOTCLOUD_REQUIRES(dispatcher_);
  void tell() IOTCLOUD_REQUIRES(dispatcher_);

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;
  const std::shared_ptr<Arrivals> arrivals_ = std::make_shared<Arrivals>();
  const std::shared_ptr<KnownInstances> known_instances_ = std::make_shared<KnownInstances>(
      [services = services_] { return services->registry->session() == discovery::SessionState::connected; });

  std::string path_;  ///< readers_path(); set by the last join()

  config::Mutex mutex_;
  config::ConditionVariable turn_over_;
  bool in_turn_ IOTCLOUD_GUARDED_BY(mutex_) = false;                               ///< a callback runs
  std::map<int, std::shared_ptr<SpoutQueue>> queues_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by task index
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  /// Timer that calls hold_back(); null: no such call is planned.
  discovery::GuardPtr after_fence_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Timer that calls share_out() because of another spout's units; null: no such call is planned.
  discovery::GuardPtr after_others_ IOTCLOUD_GUARDED_BY(mutex_);

  /// The registry's dispatcher, in in_turn(); before it the last join(), after it the first leave().
  config::ThreadRole dispatcher_;
  /// Channels that the directory shows, read or not.
  std::map<discovery::InstanceId, discovery::ChannelRecord> channels_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::unique_ptr<SplitTopics> split_topics_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< set by the last join()
  SpoutUnits units_ IOTCLOUD_GUARDED_BY(dispatcher_);
  /// Topics of exclusive channels that were read here to their end, by instance, until the channel or its record goes.
  std::map<discovery::InstanceId, UnitReaders::Key> left_queues_ IOTCLOUD_GUARDED_BY(dispatcher_);
  /// Instances whose record was not read in this session. When it is not there, the registry may have lost its data.
  std::set<discovery::InstanceId> unconfirmed_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::set<std::string> complained_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::map<discovery::InstanceId, Difference> differences_ IOTCLOUD_GUARDED_BY(dispatcher_);
  /// The instances of differences_, as the troubles name them: mostly all of a gateway have the same difference.
  std::map<Difference, std::set<discovery::InstanceId>> differing_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::string unreadable_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< a topic that could not be opened, and why
  ReadUnits read_units_ IOTCLOUD_GUARDED_BY(dispatcher_);    ///< as arrivals_ has them
  PlannedCalls plans_ IOTCLOUD_GUARDED_BY(dispatcher_);
  // While the readers are held back:
  bool registry_answered_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;
  int looks_left_ IOTCLOUD_GUARDED_BY(dispatcher_) = 0;            ///< how often read_anew() still waits for the answer
  discovery::GuardPtr question_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< a watch; null: it is not asked now
  /// Outgoing channels of instances that do not have the wanted one; the plan `missing` calls warn_of_missing().
  std::set<std::string> others_ IOTCLOUD_GUARDED_BY(dispatcher_);
  bool warned_of_missing_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;  ///< or the call is planned
  PrefetchReport prefetch_report_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::string problem_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< why this worker has no share
  bool alike_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;   ///< ReadingGroup::Shares::alike
  std::unique_ptr<Search> search_;                        ///< set by the last join(), taken by the first leave()
};

}  // namespace iotcloud::topology
