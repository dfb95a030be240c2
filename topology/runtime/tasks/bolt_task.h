#pragma once

#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/runtime/tasks/mailbox.h>
#include <iotcloud/topology/runtime/tasks/task.h>

namespace iotcloud::topology::internal {

/// What a bolt asks of the tuples that it gets.
struct Intake {
  struct Deadline {
    const detail::StreamInfo* stream = nullptr;
    std::int64_t age_ns = 0;
  };
  std::vector<Deadline> deadlines;  ///< of the streams that have one
  std::string late_stream;          ///< empty: late tuples are dropped
  std::vector<KeepLast> keep_last;
};

/// A bolt's task and its mailbox. Acks that come from other threads, and ticks, do not wait in line.
class BoltTask final : public Task, private OutputCollector {
 public:
  BoltTask(const Surroundings& surroundings, TopologyContext context, std::unique_ptr<Bolt> bolt, Intake intake,
           const detail::StreamInfo* tick_stream);
  ~BoltTask() override;

  /// \throws what the bolt's prepare() throws.
  void prepare(const Config& config, Lane& lane);

  // The mailbox. Any thread.
  void deliver(std::span<TupleCell* const> cells) { mailbox_.put(cells); }
  bool block_until_room(Task& emitter) { return mailbox_.block_until_room(emitter); }
  std::size_t room() const { return mailbox_.room(); }

  bool slice(Lane& lane) override;
  bool is_spout() const override { return false; }
  std::size_t depth() const override { return mailbox_.depth(); }
  std::int64_t waiting_ns() const override {
    return static_cast<std::int64_t>(depth()) * each_ns_.load(std::memory_order_relaxed);
  }
  void close() override;
  void fill(TaskSnapshot& snapshot) const override;
  void collect(std::vector<config::Sample>& samples) const override;
  /// Gives back what still waits. When nothing runs.
  void discard();

 private:
  enum class Answer : std::uint8_t { ack, fail, reset };

  void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) override;
  void ack(const Tuple& tuple) override;
  void fail(const Tuple& tuple) override { answer(Answer::fail, tuple); }
  void reset_timeout(const Tuple& tuple) override { answer(Answer::reset, tuple); }
  void report_error(const std::string& text) override { Task::report_error(text); }

  void send(std::span<const Tuple> anchors, Values&& values);
  void answer(Answer answer, const Tuple& tuple);
  void settle(Answer answer, const Tuple& tuple);
  void take_answers();
  void tick();
  void execute(Tuple tuple);
  bool late(const TupleCell& cell) const;
  void give_up_late(const Tuple& tuple);
  const config::Histogram& process_latency() const {
    return answers_later_.load(std::memory_order_relaxed) ? process_latency_ : execute_latency_;
  }
  void note_chunk(std::size_t taken, std::uint64_t took_ns);
  std::int64_t birth_of_child(std::span<const Tuple> anchors) const;

  std::unique_ptr<Bolt> bolt_;
  const detail::StreamInfo* tick_stream_;
  const Intake intake_;
  bool prepared_ = false;
  config::Histogram execute_latency_;
  config::Histogram process_latency_;  ///< only used once a tuple was answered later; until then it is the other one
  std::atomic<bool> answers_later_{false};

  // While in a slice.
  Lane* lane_ = nullptr;
  const TupleCell* current_ = nullptr;
  bool current_settled_ = false;
  std::size_t late_in_chunk_ = 0;     ///< taken and not executed
  std::size_t settled_in_chunk_ = 0;  ///< executed and answered before execute() returned
  std::vector<Tree*> roots_;          ///< scratch

  Mailbox mailbox_;
  std::atomic<bool> has_answers_{false};
  std::mutex answers_mutex_;
  std::vector<std::pair<Answer, Tuple>> answers_;  ///< guarded by answers_mutex_: from other threads
};

}  // namespace iotcloud::topology::internal
