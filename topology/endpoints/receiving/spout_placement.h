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
#include <iotcloud/topology/endpoints/placement/task_loads.h>
#include <iotcloud/topology/endpoints/receiving/prefetch_report.h>
#include <iotcloud/topology/endpoints/receiving/split_topics.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>
#include <iotcloud/topology/endpoints/receiving/unit_readers.h>
#include <iotcloud/topology/endpoints/receiving/verdicts.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Finds the channels that one spout component reads, and places them on its tasks. A worker has one object for each
/// such component. The unit of placement is a driver instance (exclusive channels) or a driver on a gateway (shared
/// channels); where the broker splits topics (Kafka), it is one partition of the latter. Partitions with the same
/// number of all channels of a driver on a gateway are one unit for all spouts, so that a driver's messages meet in one
/// worker; channels that are not split alike are not read (PartitionAgreement).
///
/// The workers of a group (YAML's `group`, or the workers of the topology) share the units: each runs for leader of
/// those of its fair share, so that the numbers of units of any two tasks differ by one at most, of each kind and in
/// all. Only a unit's leader reads it; the broker's exclusive consumer makes sure of that even if two workers believe
/// that they lead. A unit is drained before it moves. A unit whose last channel is gone (its drivers have stopped) is
/// read until nothing more comes, because what they sent before may still be at the broker. While the registry is away
/// no unit moves and reading goes on.
/// Thread safe.
class SpoutPlacement {
 public:
  SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);
  ~SpoutPlacement();

  /// A task calls it when it opens. The call of the last of `task_count` tasks begins the search for channels.
  void join(int task_index, int task_count, std::shared_ptr<SpoutQueue> queue);
  /// A task calls it when it closes. The first call ends all reading, and returns when no message comes any more.
  void leave();
  /// Which driver instances `where` chooses, also of those that share a channel.
  std::shared_ptr<const Verdicts> verdicts() const { return verdicts_; }

 private:
  /// Where a unit moves. Its readers are drained: they stay subscribed and take no message until those that they
  /// brought are settled or drain_limit has passed. Then the unit's next task or worker reads it.
  enum class Move { none, to_task, to_worker };
  static constexpr std::chrono::milliseconds look_period{10}, drain_limit{2000};
  /// A unit whose last channel is gone has been read to its end when it has brought nothing for `end_silence`, and no
  /// message is in hand. It is given up after `end_limit` in any case.
  static constexpr std::chrono::milliseconds end_silence{1000}, end_limit{30'000};
  struct Unit {
    explicit Unit(std::size_t& reader_count) : readers(reader_count) {}

    UnitKind kind = UnitKind::instance;
    std::optional<std::int32_t> partition;  ///< of the topics; nullopt: all of it
    std::map<discovery::InstanceId, discovery::ChannelRecord> channels;
    std::unique_ptr<discovery::Election> election;  ///< null: the unit is another worker's share
    bool leads = false;
    bool frozen = false;  ///< leadership was lost because the registry is away: reading goes on until it is back
    int task = -1;        ///< index of the task that reads it; -1: it is not read here
    Move move = Move::none;
    int looks_left = 0;  ///< while it moves or ends: how often look_at_moves() or look_at_ends() still waits for it
    // While it ends:
    discovery::InstanceId instance;         ///< whose exclusive channel it had; empty: its channels were shared
    std::optional<UnitReaders::Key> topic;  ///< of that channel
    bool undeployed = false;                ///< that instance's record is gone
    int last_task = -1;                     ///< the task that reads it
    int silent_looks = 0;                   ///< how often in a row look_at_ends() has seen nothing new
    std::size_t taken = 0;                  ///< UnitReaders::taken() at the last look
    UnitReaders readers;
  };
  /// When the reading of a unit ends whose last channel is gone.
  enum class End {
    when_silent,  ///< see end_silence
    at_once,      ///< the broker keeps its messages
  };
  struct Search;  ///< all that tells what to read: session, reading group, drivers, fence

  /// Runs a callback of the registry, unless leave() was called. No lock is held meanwhile: the callback opens and
  /// closes readers, which may take long, and nobody but leave() waits for it.
  template <typename Function>
  void in_turn(Function function) {
    if (!begin_turn()) return;
    const TurnEnd end(*this);
    dispatcher_.assert_held();
    // destroyed at the end, because they wait for their callbacks
    std::vector<std::unique_ptr<discovery::Election>> dying;
    function();
    dying.swap(resigned_);
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
  discovery::GuardPtr take_anew() IOTCLOUD_EXCLUDES(mutex_);

  // These functions run on the registry's dispatcher.
  void on_channel(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void place(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void add_to_unit(const discovery::ChannelRecord& channel, std::optional<std::int32_t> partition)
      IOTCLOUD_REQUIRES(dispatcher_);
  void remove_from_unit(const discovery::ChannelRecord& channel, const std::string& name, End end)
      IOTCLOUD_REQUIRES(dispatcher_);
  void displace(const discovery::ChannelRecord& channel, int first_partition, End end) IOTCLOUD_REQUIRES(dispatcher_);
  void follow_no_more(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  UnitReaders::Key key_of(const discovery::ChannelRecord& channel) const;
  void on_partitions() IOTCLOUD_REQUIRES(dispatcher_);
  void on_channel_gone(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void on_state(const discovery::InstanceId& instance, std::optional<discovery::DriverState> state)
      IOTCLOUD_REQUIRES(dispatcher_);
  void remove_queue(const UnitReaders::Key& topic) IOTCLOUD_REQUIRES(dispatcher_);
  void on_missing(const std::vector<discovery::ChannelRecord>& channels) IOTCLOUD_REQUIRES(dispatcher_);
  void warn_of_missing() IOTCLOUD_REQUIRES(dispatcher_);
  void look_for_limit() IOTCLOUD_REQUIRES(dispatcher_);
  void look_for_limit_soon() IOTCLOUD_REQUIRES(dispatcher_);
  bool queues_are_empty() IOTCLOUD_EXCLUDES(mutex_);
  void on_sharers(const std::vector<Sharer>& sharers, const std::string& problem) IOTCLOUD_REQUIRES(dispatcher_);
  void on_elected(const std::string& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void on_lost(const std::string& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void on_session(discovery::SessionState state) IOTCLOUD_REQUIRES(dispatcher_);
  void subscribe_anew() IOTCLOUD_REQUIRES(dispatcher_);
  bool fits(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(dispatcher_);
  void share_out_soon() IOTCLOUD_REQUIRES(dispatcher_);
  void share_out() IOTCLOUD_REQUIRES(dispatcher_);
  void stand(const std::string& name, Unit& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void move(const std::string& name, Unit& unit, Move where) IOTCLOUD_REQUIRES(dispatcher_);
  void look_soon() IOTCLOUD_REQUIRES(dispatcher_);
  void look_at_moves() IOTCLOUD_REQUIRES(dispatcher_);
  void read_to_the_end(const std::string& name) IOTCLOUD_REQUIRES(dispatcher_);
  void look_at_ends() IOTCLOUD_REQUIRES(dispatcher_);
  void begin_again(const std::string& name) IOTCLOUD_REQUIRES(dispatcher_);
  void release(const std::string& name, Unit& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void stop_reading(const std::string& name, Unit& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void read(Unit& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void balance() IOTCLOUD_REQUIRES(dispatcher_);
  std::shared_ptr<TopicReader> open_reader(const discovery::ChannelRecord& channel, const UnitReaders::Key& key,
                                           const Unit& unit) IOTCLOUD_REQUIRES(dispatcher_);
  void report() IOTCLOUD_REQUIRES(dispatcher_);
  void tell_soon() IOTCLOUD_REQUIRES(dispatcher_);
  bool alone() const IOTCLOUD_REQUIRES(dispatcher_) {
    return sharers_.size() == 1 && sharers_.front().worker == services_->worker;
  }

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;
  const std::shared_ptr<Verdicts> verdicts_ = std::make_shared<Verdicts>();

  std::string path_;  ///< readers_path(); set by the last join()

  config::Mutex mutex_;
  config::ConditionVariable turn_over_;
  bool in_turn_ IOTCLOUD_GUARDED_BY(mutex_) = false;                               ///< a callback runs
  std::map<int, std::shared_ptr<SpoutQueue>> queues_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by task index
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  /// Timer that calls subscribe_anew(); null: no such call is planned.
  discovery::GuardPtr anew_ IOTCLOUD_GUARDED_BY(mutex_);

  /// The registry's dispatcher, in in_turn(); before it the last join(), after it the first leave().
  config::ThreadRole dispatcher_;
  std::vector<Sharer> sharers_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< empty: not known yet
  /// Channels that the directory shows, read or not.
  std::map<discovery::InstanceId, discovery::ChannelRecord> channels_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::unique_ptr<SplitTopics> split_topics_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< set by the last join()
  std::map<std::string, Unit> units_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::map<std::string, Unit> ending_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< without channels, read to their end
  /// Topics of exclusive channels that were read here to their end, by instance, until the channel or its record goes.
  std::map<discovery::InstanceId, UnitReaders::Key> left_queues_ IOTCLOUD_GUARDED_BY(dispatcher_);
  /// Instances whose record was not read in this session. When it is not there, the registry may have lost its data.
  std::set<discovery::InstanceId> unconfirmed_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::set<std::string> complained_ IOTCLOUD_GUARDED_BY(dispatcher_);
  TaskLoads loads_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::size_t reader_count_ IOTCLOUD_GUARDED_BY(dispatcher_) = 0;
  std::vector<std::unique_ptr<discovery::Election>> resigned_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< of released units
  bool sharing_soon_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;     ///< a call of share_out() is planned
  discovery::GuardPtr sharing_ IOTCLOUD_GUARDED_BY(dispatcher_);   ///< timer that calls share_out()
  std::set<std::string> moving_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< names of units that move
  bool looking_soon_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;     ///< a call of the next function is planned
  discovery::GuardPtr looking_ IOTCLOUD_GUARDED_BY(dispatcher_);   ///< timer: look_at_moves(), look_at_ends()
  std::size_t taken_ IOTCLOUD_GUARDED_BY(dispatcher_) = 0;     ///< number of units taken since the last line in the log
  std::size_t given_up_ IOTCLOUD_GUARDED_BY(dispatcher_) = 0;  ///< number of units given up since then
  bool telling_soon_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;    ///< a line in the log is planned
  discovery::GuardPtr telling_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< timer that writes that line
  /// Outgoing channels of instances that do not have the wanted one; a timer calls warn_of_missing().
  std::set<std::string> others_ IOTCLOUD_GUARDED_BY(dispatcher_);
  bool warned_of_missing_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;  ///< or the call is planned
  discovery::GuardPtr missing_ IOTCLOUD_GUARDED_BY(dispatcher_);
  discovery::GuardPtr limit_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< timer that calls look_for_limit()
  bool limit_soon_ IOTCLOUD_GUARDED_BY(dispatcher_) = false;    ///< that call is planned
  PrefetchReport prefetch_report_ IOTCLOUD_GUARDED_BY(dispatcher_);
  std::string problem_ IOTCLOUD_GUARDED_BY(dispatcher_);  ///< why this worker has no share
  std::unique_ptr<Search> search_;                        ///< set by the last join(), taken by the first leave()
};

}  // namespace iotcloud::topology
