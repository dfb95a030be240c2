#pragma once

#include <memory>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/runtime/task.h>

namespace iotcloud::topology::internal {

/// A bolt's task and its mailbox. Emitters put tuples in batches; when so many wait that the mailbox is full, they are
/// not run again until half of them are gone. Acks that come from other threads, and ticks, do not wait in line.
class BoltTask final : public Task, private OutputCollector {
 public:
  BoltTask(const Surroundings& surroundings, TopologyContext context, std::unique_ptr<Bolt> bolt,
           const detail::StreamInfo* tick_stream);
  ~BoltTask() override;

  /// \throws what the bolt's prepare() throws.
  void prepare(const Config& config, Lane& lane);

  /// Takes over one handle of each. Any thread.
  void deliver(std::span<TupleCell* const> cells);
  /// Makes `emitter` wait until there is room. \return false when there is room already.
  bool block_until_room(Task& emitter);
  bool full(std::size_t more) const { return depth() + more >= capacity_; }

  bool slice(Lane& lane) override;
  bool is_spout() const override { return false; }
  std::size_t depth() const override { return depth_.load(std::memory_order_relaxed); }
  void close() override;
  void fill(TaskSnapshot& snapshot) const override;
  /// Gives back what still waits. When nothing runs.
  void discard();

 private:
  enum class Answer : std::uint8_t { ack, fail, reset };

  void emit_to(const std::string& stream, std::span<const Tuple> anchors, Values values) override;
  void emit_direct(int task, const std::string& stream, std::span<const Tuple> anchors, Values values) override;
  void ack(const Tuple& tuple) override { answer(Answer::ack, tuple); }
  void fail(const Tuple& tuple) override { answer(Answer::fail, tuple); }
  void reset_timeout(const Tuple& tuple) override { answer(Answer::reset, tuple); }
  void report_error(const std::string& text) override { Task::report_error(text); }

  void emit(int direct_task, const std::string& stream, std::span<const Tuple> anchors, Values&& values);
  void answer(Answer answer, const Tuple& tuple);
  void settle(Answer answer, const Tuple& tuple);
  void take_answers();
  void tick();
  void execute(Tuple tuple);
  bool refill();  ///< \return false when nothing waits
  void done(std::size_t executed);

  std::unique_ptr<Bolt> bolt_;
  const detail::StreamInfo* tick_stream_;
  const std::size_t capacity_;
  config::Histogram* execute_latency_;
  bool prepared_ = false;

  // While in a slice.
  Lane* lane_ = nullptr;
  const TupleCell* current_ = nullptr;
  bool current_settled_ = false;
  std::vector<Tree*> roots_;  ///< scratch
  std::vector<TupleCell*> batch_;
  std::size_t next_ = 0;  ///< in batch_

  std::atomic<std::size_t> depth_{0};  ///< in waiting_ and batch_
  std::atomic<bool> has_blocked_{false};
  std::atomic<bool> has_answers_{false};
  std::mutex mutex_;
  std::vector<TupleCell*> waiting_;                ///< guarded by mutex_
  std::vector<Task*> blocked_;                     ///< guarded by mutex_: emitters that wait for room
  std::vector<std::pair<Answer, Tuple>> answers_;  ///< guarded by mutex_: from other threads
};

}  // namespace iotcloud::topology::internal
