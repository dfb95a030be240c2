#pragma once

#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/runtime/tasks/mailbox.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

/// A bolt's deadlines and keep_last, which decide which of its tuples are executed.
struct InputPolicies {
  struct Deadline {
    const detail::StreamInfo* stream = nullptr;
    std::int64_t age_ns = 0;
  };
  std::vector<Deadline> deadlines;  ///< one for each input stream that has a deadline
  std::string late_stream;          ///< empty: late tuples are dropped
  std::vector<KeepLast> keep_last;
};

/// Counts of one of several inputs of a bolt's task. The thread that runs the task writes them, any thread reads them.
struct InputCounts {
  const detail::StreamInfo* stream = nullptr;
  std::atomic<std::uint64_t> executed{0}, acked{0}, failed{0}, late{0};
};

/// A bolt's task and its mailbox. Answers (acks and fails) that come from other threads, and ticks, do not wait behind
/// the tuples in the mailbox: the next slice takes them first.
class BoltTask final : public Task, private OutputCollector {
 public:
  /// \param inputs the streams that it reads, each once.
  BoltTask(const TaskEnvironment& environment, Executors& executors, TopologyContext context,
           std::unique_ptr<Bolt> bolt, const std::vector<const detail::StreamInfo*>& inputs, InputPolicies policies,
           const detail::StreamInfo* tick_stream);
  ~BoltTask() override;

  /// \throws what the bolt's prepare() throws.
  void prepare(const Config& config, EmittingLane& lane);

  // Access to the mailbox, on any thread; see Mailbox.
  void deliver(std::span<TupleCell* const> cells) { mailbox_.put(cells); }
  void hand(CellList& cells) { mailbox_.hand(cells); }
  bool block_until_room(Task& emitter) { return mailbox_.block_until_room(emitter); }
  std::size_t room() const { return mailbox_.room(); }

  bool slice(Lane& lane) override;
  bool is_spout() const override { return false; }
  std::size_t depth() const override { return mailbox_.depth(); }
  std::int64_t worth_moving_ns() const override {
    if (each_handled_ns_.load(std::memory_order_relaxed) < heavy_ns) return 0;
    return static_cast<std::int64_t>(depth()) * each_ns_.load(std::memory_order_relaxed);
  }
  void close() override;
  void fill(TaskSnapshot& snapshot) const override;
  void collect(std::vector<config::Sample>& samples) const override;
  /// Destroys the bolt, and releases the tuples that still wait. \pre no thread runs a task any more.
  void discard();

 private:
  enum class Answer : std::uint8_t { ack, fail, retry, reset };

  void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) override;
  void ack(const Tuple& tuple) override;
  void fail(const Tuple& tuple) override { answer(Answer::fail, tuple); }
  void retry(const Tuple& tuple) override { answer(Answer::retry, tuple); }
  bool is_void(const Tuple& tuple) const override;
  void reset_timeout(const Tuple& tuple) override { answer(Answer::reset, tuple); }
  void report_error(const std::string& text) override { Task::report_error(text); }

  void emit_any(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task);
  void send(std::span<const Tuple> anchors, Values&& values, std::int64_t born);
  void answer(Answer answer, const Tuple& tuple);
  void settle(Answer answer, const Tuple& tuple);
  void take_answers();
  void tick();
  std::int64_t begin_watched(const Tuple& tuple);
  void note_executed(const TupleCell& cell, std::int64_t begin_ns) const;
  template <bool plain, bool several>
  std::size_t execute_some(std::span<TupleCell* const> cells);
  std::size_t execute_chunk();
  InputCounts* find_input(const detail::StreamInfo* stream);
  void leave_open(TupleCell& cell);
  void disinherit(TupleCell& parent);
  bool late(const TupleCell& cell) const;
  void give_up_late(const Tuple& tuple);
  const config::Histogram& process_latency() const {
    return answers_later_.load(std::memory_order_relaxed) ? process_latency_ : execute_latency_;
  }
  void note_chunk(std::size_t taken, std::uint64_t took_ns);
  std::int64_t birth_of_child(std::span<const Tuple> anchors) const;

  /// A task is heavy when it works for at least this long for each tuple that it executes or emits. Tuples of lighter
  /// ones are not worth another core: their way to its cache takes longer than the work on them.
  static constexpr std::int64_t heavy_ns = 400;
  // Estimates of how long execute() takes, and of that time for each tuple that it takes or emits. A shorter
  // measurement replaces an estimate; a longer one raises it by an eighth of the difference, because a measurement is
  // too long when the thread had to wait for a core.
  std::atomic<std::int64_t> each_ns_{0}, each_handled_ns_{0};
  static void note(std::atomic<std::int64_t>& estimate, std::int64_t ns) {
    const std::int64_t before = estimate.load(std::memory_order_relaxed);
    estimate.store(ns <= before ? ns : before + (ns - before + 7) / 8, std::memory_order_relaxed);
  }

  std::unique_ptr<Bolt> bolt_;
  const detail::StreamInfo* tick_stream_;
  const InputPolicies policies_;
  std::vector<InputCounts> inputs_;  ///< empty: the task has one input, whose counts are the task's
  bool prepared_ = false;
  config::Histogram execute_latency_;
  /// Used from the first answer after execute() returned; before, the two latencies are equal.
  config::Histogram process_latency_;
  std::atomic<bool> answers_later_{false};

  // Used only in a slice.
  EmittingLane* lane_ = nullptr;
  TupleCell* current_ = nullptr;  ///< the tuple in execute()
  TupleCell* open_ = nullptr;     ///< the same, until the bolt acks or fails it
  /// The first tuple that was emitted with `open_` as its only anchor, until that one is answered or left open. No one
  /// has it yet, and its delivery has no id: an ack gives it what the delivery of `open_` has to settle, so that the
  /// tree need not hear of that one.
  TupleCell* heir_ = nullptr;
  std::size_t acked_in_chunk_ = 0;  ///< acks of this chunk that are not counted yet
  std::size_t late_in_chunk_ = 0;   ///< tuples of this chunk that were late, so not executed
  std::size_t left_in_chunk_ = 0;   ///< tuples of this chunk that were not answered when execute() returned
  std::vector<Tree*> roots_;        ///< only used in send(); a member, to keep its memory

  Mailbox mailbox_;
  std::atomic<bool> has_answers_{false};
  config::Mutex answers_mutex_;
  std::vector<std::pair<Answer, Tuple>> answers_ IOTCLOUD_GUARDED_BY(answers_mutex_);  ///< answers from other threads
};

}  // namespace iotcloud::topology::internal
