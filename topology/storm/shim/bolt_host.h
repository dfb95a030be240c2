#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/storm/shim/answer_queue.h>
#include <iotcloud/topology/storm/shim/call_timer.h>
#include <iotcloud/topology/storm/shim/kept_tuples.h>
#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/shim/task_host.h>

namespace iotcloud::topology::storm {

/// The values of a tuple that Java hands over.
struct HandedValues {
  std::span<const std::byte> bytes{};  ///< as in value_format.h, with
  JavaArrays* arrays = nullptr;
  ParcelPtr parcel = nullptr;  ///< has the values, if there is one
};

/// A bolt's task. Answers (acks, fails, time-outs that begin anew, errors) that come from other threads wait until Java
/// fetches them (take_answers()), which the queue tells it to do.
class BoltHost final : public TaskHost, private OutputCollector {
 public:
  /// \param queue lives as long.
  BoltHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink,
           AnswerQueue& queue);
  ~BoltHost() override;

  /// Executes a tuple. \param slot the tuple's for Java. \param input the number of its stream among the task's
  /// inputs.
  std::size_t execute(std::uint32_t slot, std::size_t input, int source_task, HandedValues values);
  std::size_t tick();
  std::size_t take_answers();

  /// Whether an input has keep_last. Then keep() and request_tick() are called on any thread, in place of execute() and
  /// tick(), and a thread of Java calls run_next() again and again.
  bool keeps() const { return kept_ != nullptr; }
  /// Queues a tuple; waits for room if its input has no keep_last. \return the slot of the tuple that it replaces,
  /// which Java acks; -1: it replaces none
  std::int64_t keep(std::uint32_t slot, std::size_t input, int source_task, HandedValues values);
  void request_tick() { kept_->request_tick(); }
  /// Waits for a tuple, a tick or answers, and lets the bolt execute them. \return as execute(); -1: end_keeping() was
  /// called.
  std::int64_t run_next();
  void end_keeping() { kept_->end(); }

  /// How often Java itself calls tick(), because Storm's own ticks come every whole number of seconds; 0: it need not.
  std::chrono::microseconds own_tick_period() const;

 private:
  void open_component() override;
  void close_component() override;
  enum class Answer : std::uint8_t { ack, fail, reset, forget };
  struct Received;

  void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) override;
  void ack(const Tuple& tuple) override { answer(Answer::ack, tuple); }
  void fail(const Tuple& tuple) override { answer(Answer::fail, tuple); }
  void reset_timeout(const Tuple& tuple) override { answer(Answer::reset, tuple); }
  void report_error(const std::string& text) override;

  Received* receive(std::uint32_t slot, std::size_t input, int source_task);
  void fill(Received& received, std::size_t input, HandedValues& values) const;
  /// Lets the bolt execute a tuple.
  void run(const Tuple& tuple, std::size_t input);
  void run_tick();
  void write_answers();
  /// Tells Java's thread that answers wait.
  void tell();
  void answer(Answer answer, const Tuple& tuple);
  void put(Answer answer, std::uint32_t slot);
  void write(Answer answer, std::uint32_t slot);
  bool late(const Received& tuple, std::size_t input) const;
  void give_up_late(const Tuple& tuple);
  std::int64_t birth_of_child(std::span<const Tuple> anchors) const;
  /// Fills kept_values_ with the payloads among the values that the anchors, or the tuple in execute(), brought.
  void find_kept(std::span<const Tuple> anchors, std::span<const Value> values);

  AnswerQueue& queue_;
  config::Counter& late_;
  config::Counter& superseded_;
  CallTimer execute_;
  std::vector<detail::StreamInfo> streams_;  ///< of the inputs
  std::vector<std::int64_t> deadlines_ns_;   ///< of the inputs; 0: none
  const detail::StreamInfo tick_stream_{system_component, tick_stream, {}};
  std::unique_ptr<Bolt> bolt_;
  std::unique_ptr<KeptTuples> kept_;   ///< null: no input has keep_last
  const Received* current_ = nullptr;  ///< the tuple in execute()
  // Only used in do_emit(); members, to keep their memory.
  std::vector<std::uint32_t> anchors_;
  std::vector<std::optional<JavaValue>> kept_values_;

  config::Mutex mutex_;
  std::vector<std::pair<Answer, std::uint32_t>> answers_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<std::string> errors_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology::storm
