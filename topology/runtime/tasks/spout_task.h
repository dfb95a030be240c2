#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/runtime/tasks/task.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology::internal {

/// Lets SpoutWakers outlive the task.
class WakeGate final : public SpoutWaker::Target {
 public:
  void wake() noexcept override;
  void open(class SpoutTask& task) { task_ = &task; }
  /// Returns when no wake() is under way; those that follow do nothing.
  void shut() noexcept;

 private:
  static constexpr std::uint32_t shut_bit = 1U << 31;
  std::atomic<std::uint32_t> users_{0};
  SpoutTask* task_ = nullptr;  ///< set before the first waker is given out
};

/// A spout's task, and the trees of its tracked tuples: a timing wheel of nine slots, each an eighth of the time-out
/// wide, so that a tree fails between T and T + T/8 after it was emitted.
class SpoutTask final : public Task, private SpoutOutputCollector {
 public:
  /// \param max_pending tracked tuples under way; 0: no limit.
  SpoutTask(const Surroundings& surroundings, TopologyContext context, std::unique_ptr<Spout> spout,
            std::shared_ptr<WakeGate> gate, std::size_t max_pending);
  ~SpoutTask() override;

  /// \throws what the spout's open() and activate() throw.
  void open(const Config& config, Lane& lane);
  /// Runs on this thread when idle. Any thread.
  void wake() noexcept;
  void set_active(bool active);
  /// A tree is done, failed or lost. Any thread.
  void post(Tree& tree) noexcept;
  /// Trees that still may end by an ack or a fail.
  std::size_t under_way() const {
    const std::size_t abandoned = abandoned_.load(std::memory_order_relaxed);
    return std::max(pending_.load(std::memory_order_relaxed), abandoned) - abandoned;
  }

  bool slice(Lane& lane) override;
  bool is_spout() const override { return true; }
  std::size_t depth() const override { return 0; }
  std::int64_t waiting_ns() const override { return each_ns_.load(std::memory_order_relaxed); }
  void close() override;
  void fill(TaskSnapshot& snapshot) const override;
  void collect(std::vector<config::Sample>& samples) const override;
  WakeGate& gate() { return *gate_; }

 private:
  static constexpr std::size_t slots = 9;

  void do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) override;
  void report_error(const std::string& text) override { Task::report_error(text); }

  void switch_activity();
  bool may_ask();
  bool ask(Lane& lane);
  void take_posted();
  void take_acked_at_once();
  void finish(Tree& tree, bool acked, bool timed_out);
  void track(Tree& tree);
  void link(Tree& tree, std::size_t slot);
  void unlink(Tree& tree);
  void turn_wheel();
  void expire(std::size_t slot, std::int64_t now);
  void arm_wheel();
  std::int64_t slot_width_ns() const;

  std::unique_ptr<Spout> spout_;
  std::shared_ptr<WakeGate> gate_;
  const std::size_t max_pending_;  ///< 0: no limit
  config::Histogram complete_latency_;
  bool opened_ = false;

  std::atomic<bool> woken_{false};
  std::atomic<bool> wanted_active_{true};
  std::atomic<Tree*> posted_{nullptr};  ///< a stack
  std::atomic<std::size_t> pending_{0};
  std::atomic<std::size_t> abandoned_{0};

  // While in a slice.
  Lane* lane_ = nullptr;
  /// The topology's clock at the last look: tuples are stamped with it. Calls between two looks are some microseconds.
  std::int64_t now_ns_ = 0;
  /// The same when next_tuple() was called, which is when its tuples are born: what a spout looks at then (is this
  /// message still mine?) it looks at after their birth. 0: in no such call, or nobody asks for births.
  std::int64_t asked_ns_ = 0;
  bool active_ = false;
  bool throttled_ = false;
  std::vector<MessageId> acked_at_once_;
  std::array<Tree*, slots> wheel_{};  ///< newest of each slot
  std::size_t slot_ = 0;              ///< that new trees go to
  std::int64_t slot_ends_ns_ = 0;
  bool wheel_armed_ = false;
  bool poll_armed_ = false;
};

}  // namespace iotcloud::topology::internal
