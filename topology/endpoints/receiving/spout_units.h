#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/placement/driver_units.h>
#include <iotcloud/topology/endpoints/placement/fair_shares.h>
#include <iotcloud/topology/endpoints/placement/task_loads.h>
#include <iotcloud/topology/endpoints/receiving/unit_readers.h>

namespace iotcloud::topology {

/// The units of placement that one spout component has in one worker: decides for which of them the worker runs for
/// leader, which task reads each unit that it leads, and when a unit's readers are opened, drained and closed.
///
/// It knows no registry, broker or timer. Its owner says what happened (channels that come and go, elections, workers
/// that share), calls look() every look_period while needs_look(), and share_out() soon when needs_sharing(). All waits
/// are counted in looks, so a process that stood still does not give up a unit for the time in which it ran nothing.
/// Not thread safe.
class SpoutUnits {
 public:
  static constexpr std::chrono::milliseconds look_period{10}, drain_limit{2000};
  /// A unit whose last channel is gone is idle while its broker delivers, nothing comes and nothing is settled. It has
  /// been read to its end when it was idle for `end_silence` without a message in hand. When it was idle for
  /// `stuck_limit` with messages in hand, it is given up. Time in which messages come or are settled does not count
  /// (what the driver had sent may be hours of messages), nor does time in which its broker is away. Nobody waits for
  /// this: the order to stop an instance is answered without it, and close() ends it when the worker is stopped. A unit
  /// is given up after `longest_end` in any case. What is given up stays at the broker for the instance's next life. A
  /// unit that was about to come here from another worker is read to its end, too, once this worker leads it; so is one
  /// that this worker gave to another one, because that one may not have run for it when its channel went. A unit whose
  /// leadership is lost meanwhile is read by whoever leads it then, and here again if that is this worker.
  static constexpr std::chrono::milliseconds end_silence{1000}, stuck_limit{30'000};
  static constexpr std::chrono::minutes longest_end{60};

  struct Options {
    std::string component;  ///< for the log
    std::string worker;     ///< this worker's name among the sharers
    /// Runs for leader of the unit of this name until the guard is destroyed. The owner passes the results to
    /// on_elected() and on_lost().
    std::function<discovery::GuardPtr(const std::string& unit)> run_for_leader;
    /// Opens a reader of a topic for a task; null: it cannot be opened now. `partition`: nullopt is the whole topic.
    std::function<std::shared_ptr<TopicReader>(const discovery::ChannelRecord& channel, const UnitReaders::Key& topic,
                                               std::optional<std::int32_t> partition, int task)>
        open_reader;
    /// Gets the names of this spout's units, and returns those of all units that are shared out together with them;
    /// empty: no others.
    std::function<UnitNames(const UnitNames& own)> shared_together{};
    std::chrono::milliseconds longest_drain = drain_limit;
  };
  /// When the reading of a unit ends whose last channel is gone.
  enum class End {
    when_silent,  ///< see end_silence
    at_once,      ///< the broker keeps its messages
  };
  /// An exclusive channel that was read to its end, or given up.
  struct EndedTopic {
    discovery::InstanceId instance;
    UnitReaders::Key topic;
    bool undeployed = false;  ///< undeployed() was called for that instance meanwhile
  };
  /// How many units were taken and given up.
  struct Changes {
    std::size_t taken = 0, given_up = 0;
  };

  explicit SpoutUnits(Options options) : options_(std::move(options)) {}
  SpoutUnits(const SpoutUnits&) = delete;
  SpoutUnits& operator=(const SpoutUnits&) = delete;

  /// To be called before all others. \param tasks of the spout in this worker
  void begin(std::size_t tasks) { loads_ = TaskLoads(tasks); }

  /// Puts a channel into a unit, which is made if it is not there.
  void add(const std::string& name, const discovery::ChannelRecord& channel, const UnitReaders::Key& topic,
           std::optional<std::int32_t> partition);
  void remove(const std::string& name, const discovery::InstanceId& instance, End end);
  bool contains(const std::string& name) const { return units_.contains(name); }
  /// The instance's record is gone: EndedTopic::undeployed of its unit that is being read to its end.
  void undeployed(const discovery::InstanceId& instance);

  /// The workers that share the units changed. Takes effect with share_out().
  void set_sharers(std::vector<Sharer> sharers) { sharers_ = std::move(sharers); }
  /// Runs for leader of the units of this worker's fair share, and gives the others up.
  void share_out();
  /// Moves units between this worker's tasks while they are uneven.
  void balance();
  void on_elected(const std::string& name);
  /// \param registry_away leadership was lost because the registry is away: reading goes on until it is back.
  void on_lost(const std::string& name, bool registry_away);
  /// The registry is back: gives up the units that were kept without it, unless this worker leads them again.
  void registry_back();
  /// Closes all readers after the fence was raised. None is opened before read_anew(): until the registry has said who
  /// leads, other workers may read these units, and a broker's client may still have messages that those have handled.
  void hold_back();
  bool held_back() const { return held_back_; }
  /// Opens all readers again, those of units that are being read to their end, too: the broker then delivers only to
  /// the reader that it accepts now, and again what was not settled.
  void read_anew();
  /// Tries again to open what could not be opened. A unit that ends has not been read to its end before that.
  void open_missing();
  /// Continues moves and ends. \return the exclusive channels whose units ended
  std::vector<EndedTopic> look();
  /// Closes all readers, and resigns everywhere.
  void close();

  /// Whether look() is to be called in look_period.
  bool needs_look() const { return !moving_.empty() || !ending_.empty(); }
  /// Whether units came or went since the last share_out().
  bool needs_sharing() const { return needs_sharing_; }
  /// Guards of run_for_leader() of units that were given up. Destroying them may wait for their callbacks.
  std::vector<discovery::GuardPtr> take_resigned() { return std::exchange(resigned_, {}); }
  /// Whether take_changes() has any.
  bool has_changes() const { return changes_.taken + changes_.given_up > 0; }
  Changes take_changes() { return std::exchange(changes_, {}); }
  std::size_t size() const { return units_.size(); }
  /// Brings a list of the units that tasks of this worker read up to date. \return whether it has changed
  bool list_read_here(ReadUnits& list) const;
  std::size_t read_here() const;  ///< number of units that a task of this worker reads
  std::size_t readers() const { return totals_.open; }
  /// How many topics could not be opened; open_missing() tries again.
  std::size_t missing() const { return totals_.missing; }
  /// Whether the broker does not deliver to a reader of this worker.
  bool cut_off() const;
  /// The instances with exclusive channels that are being read to their end.
  std::set<discovery::InstanceId> ending_instances() const;
  /// How many readers get no more messages until some are settled.
  std::size_t at_limit() const;
  /// The greatest prefetch of a reader; 0: there is none.
  std::size_t prefetch() const;
  /// Asks the brokers what waits for readers, for as many as it takes to reach `most`, in turn.
  void ask_backlog(std::size_t most);
  /// The last answers of all readers.
  Backlog backlog() const;

 private:
  /// Where a unit moves. Its readers are drained: they stay subscribed and take no message until those that they
  /// brought are settled or drain_limit has passed. Then the unit's next task or worker reads it.
  enum class Move { none, to_task, to_worker };
  struct Channel {
    discovery::ChannelRecord record;
    UnitReaders::Key topic;
  };
  struct Unit {
    explicit Unit(UnitReaders::Totals& totals) : readers(totals) {}

    UnitKind kind = UnitKind::instance;
    std::optional<std::int32_t> partition;              ///< of the topics; nullopt: all of it
    std::map<discovery::InstanceId, Channel> channels;  ///< while it ends: the one that went last
    discovery::GuardPtr candidacy;  ///< of run_for_leader(); null: the unit is another worker's share
    bool leads = false;
    bool frozen = false;      ///< leadership was lost because the registry is away: reading goes on until it is back
    bool given_away = false;  ///< it was read here and moved to another worker, which may not run for it yet
    int task = -1;            ///< index of the task that reads it; -1: it is not read here
    Move move = Move::none;
    int looks_left = 0;  ///< while it moves: how often look() still waits for it; while it ends: at most
    // While it ends:
    discovery::InstanceId instance;         ///< whose exclusive channel it had; empty: its channels were shared
    std::optional<UnitReaders::Key> topic;  ///< of that channel
    bool undeployed = false;                ///< that instance's record is gone
    int last_task = -1;                     ///< the task that reads it; -1: it is not read here yet
    int idle_looks = 0;                     ///< how often in a row look() has seen it idle
    std::size_t taken = 0;                  ///< UnitReaders::taken() at the last look
    std::size_t in_hand = 0;                ///< UnitReaders::in_hand() at the last look
    UnitReaders readers;

    /// Of a unit that ends: whether this worker does not lead it yet.
    bool waits_for_election() const { return last_task < 0; }
  };

  bool alone() const { return sharers_.size() == 1 && sharers_.front().worker == options_.worker; }
  void run_for_leader(const std::string& name, Unit& unit);
  void move(const std::string& name, Unit& unit, Move where);
  void look_at_moves();
  std::vector<EndedTopic> look_at_ends();
  void read_to_the_end(const std::string& name);
  void begin_end(Unit& unit);
  static void count_anew(Unit& unit);
  void begin_again(const std::string& name);
  void release(const std::string& name, Unit& unit);
  void stop_reading(const std::string& name, Unit& unit);
  void open_anew(Unit& unit);
  void read(Unit& unit);

  const Options options_;
  std::vector<Sharer> sharers_;  ///< empty: not known yet
  UnitReaders::Totals totals_;
  std::map<std::string, Unit> units_;
  std::map<std::string, Unit> ending_;  ///< of channels that are gone: read to their end
  std::set<std::string> moving_;        ///< names of units that move
  std::string asked_last_;              ///< the unit for which ask_backlog() asked last
  TaskLoads loads_;
  std::vector<discovery::GuardPtr> resigned_;  ///< of released units
  bool needs_sharing_ = false;
  bool held_back_ = false;  ///< no reader is opened
  Changes changes_;
};

}  // namespace iotcloud::topology
