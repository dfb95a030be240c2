#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/tasks/task.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology::internal {

/// The target of a SpoutWaker. It passes wake() on to its task until shut(), so that wakers may outlive the task.
class WakeGate final : public SpoutWaker::Target {
 public:
  void wake() noexcept override;
  void open(class SpoutTask& task) { task_ = &task; }
  /// Waits until no wake() is under way; later calls of wake() do nothing.
  void shut() noexcept;

 private:
  static constexpr std::uint32_t shut_bit = 1U << 31;
  std::atomic<std::uint32_t> users_{0};
  SpoutTask* task_ = nullptr;  ///< set before the first waker is given out
};

/// A spout's task, and the trees of its tracked tuples. The trees are in a timing wheel of nine slots, each an eighth
/// of the message time-out T wide, so that a tree that is not done fails between T and 9/8 T after it was emitted.
class SpoutTask final : public Task, private SpoutOutputCollector {
 public:
  /// \param max_pending how many tracked tuples may be under way; 0: no limit.
  SpoutTask(const TaskEnvironment& environment, Executors& executors, TopologyContext context,
            std::unique_ptr<Spout> spout, std::shared_ptr<WakeGate> gate, std::size_t max_pending);
  ~SpoutTask() override;

  /// \throws what the spout's open() and activate() throw.
  void open(const Config& config, EmittingLane& lane);
  /// Has next_tuple() called; an idle task runs on the calling thread. Any thread.
  void wake() noexcept;
  void set_active(bool active);
  /// Tells the task what was settled in its trees; the next slice looks at it. Any thread. \param settlements left
  /// empty.
  void tell(FlatList<Settlement>& settlements) noexcept;
  bool runs_on(const Scheduler& scheduler) const { return environment_.scheduler == &scheduler; }
  /// Number of trees that an ack or a fail may still end. Abandoned trees do not count: only the time-out ends them.
  std::size_t under_way() const {
    const std::size_t abandoned = abandoned_.load(std::memory_order_relaxed);
    return std::max(pending_.load(std::memory_order_relaxed), abandoned) - abandoned;
  }

  bool slice(Lane& lane) override;
  bool is_spout() const override { return true; }
  std::size_t depth() const override { return 0; }
  /// What a spout brings is work of its own: a second spout that is ready is worth another core.
  std::int64_t worth_moving_ns() const override { return Scheduler::worth_sharing_ns / 2; }
  void close() override;
  void fill(TaskSnapshot& snapshot) const override;
  void collect(std::vector<config::Sample>& samples) const override;
  WakeGate& gate() { return *gate_; }

 private:
  static constexpr std::size_t slots = 9;

  void do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) override;
  void do_emit_from(std::shared_ptr<const TupleOrigin> origin, std::string_view stream, Values&& values,
                    MessageId id) override;
  void report_error(const std::string& text) override { Task::report_error(text); }

  void emit_any(std::string_view stream, Values&& values, int task, const MessageId* id);
  Tree* make_tree(MessageId id);
  std::int64_t birth() const;
  void switch_activity();
  bool may_ask() {
    if (active_ && !throttled_ && !full()) return true;
    return decide_to_ask();
  }
  /// False: the spout has said that it has nothing, and only acks came since. A spout that is asked after each ack
  /// finds what became due meanwhile, a few tuples each time. Those cost more than tuples in a batch, and the thread
  /// that brings messages is never done with them.
  bool may_have_more(std::uint32_t signals) const {
    return !dry_ || signals != 0 || woken_.load(std::memory_order_acquire);
  }
  bool full() const {
    return blocked() || (max_pending_ > 0 && pending_.load(std::memory_order_relaxed) >= max_pending_);
  }
  bool decide_to_ask();
  bool ask(EmittingLane& lane);
  void take_settlements();
  bool apply(const Settlement& settlement);
  void take_acked_at_once();
  void finish_acked(Tree& tree);
  void finish_failed(Tree& tree, bool timed_out);
  void note_failure(bool timed_out, bool dropped);
  void tell_failures();
  void track(Tree& tree);
  void link(Tree& tree, std::size_t slot);
  void unlink(Tree& tree);
  void turn_wheel();
  void expire(std::size_t slot, std::int64_t now);
  void arm_wheel();
  void note_oldest();
  std::int64_t slot_width_ns() const;

  std::unique_ptr<Spout> spout_;
  std::shared_ptr<WakeGate> gate_;
  const std::size_t max_pending_;  ///< 0: no limit
  config::Histogram complete_latency_;
  bool opened_ = false;

  std::atomic<bool> woken_{false};  ///< wake() was called since next_tuple() was called last
  std::atomic<bool> wanted_active_{true};
  std::atomic<bool> has_settlements_{false};
  config::Mutex settlements_mutex_;
  FlatList<Settlement> settlements_ IOTCLOUD_GUARDED_BY(settlements_mutex_);
  std::atomic<std::size_t> pending_{0};     ///< number of trees in the wheel
  std::atomic<std::size_t> abandoned_{0};   ///< number of trees whose Tree::abandoned is set
  std::atomic<std::int64_t> oldest_ns_{0};  ///< emitted_ns of the oldest tree, after the last slice; 0: there is none

  // Used only in a slice.
  EmittingLane* lane_ = nullptr;
  /// The topology's clock when it was last read; a tree's emitted_ns. It is read once for a chunk of calls, which takes
  /// some microseconds.
  std::int64_t now_ns_ = 0;
  /// The topology's clock when next_tuple() was called; the birth of the tuples that the call emits. It is read before
  /// the call, so that what the spout checks in the call (is this message still mine?) it checks after that time. 0: no
  /// call runs, or tuples do not record their birth.
  std::int64_t asked_ns_ = 0;
  std::shared_ptr<const TupleOrigin> origin_;  ///< of the tuple in do_emit_from()
  FlatList<Settlement> settling_;              ///< only used in take_settlements(); a member, to keep its memory
  std::vector<Tree*> failing_;                 ///< the same
  bool active_ = false;
  /// next_tuple() returned false, and nothing has happened since after which it is called again.
  bool dry_ = false;
  bool throttled_ = false;
  std::vector<MessageId> acked_at_once_;  ///< messages whose tuple has no receiver, or is not tracked (`acking` is off)
  std::array<Tree*, slots> wheel_{};      ///< the newest tree of each slot
  std::array<Tree*, slots> tails_{};      ///< the oldest tree of each slot
  std::size_t slot_ = 0;                  ///< the slot that new trees go to
  std::int64_t slot_ends_ns_ = 0;         ///< when the wheel turns to the next slot, by the topology's clock
  bool wheel_armed_ = false;
  bool poll_armed_ = false;

  /// Trees that failed since the last line of the log about them, by cause.
  struct Failures {
    std::uint64_t by_bolt = 0;  ///< a bolt failed a tuple, or threw
    std::uint64_t timed_out = 0;
    std::uint64_t dropped = 0;  ///< a bolt destroyed a tuple without ack or fail
  };
  Failures failures_;
  bool failures_armed_ = false;        ///< a line is planned
  std::int64_t next_failures_ns_ = 0;  ///< the earliest time of the next line, by the topology's clock
};

}  // namespace iotcloud::topology::internal
