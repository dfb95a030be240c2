#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/tuple.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

class BasicOutputCollector;
struct TopologyContext;

/// A component declares to it the streams that it emits, before the topology runs.
class OutputFieldsDeclarer {
 public:
  virtual ~OutputFieldsDeclarer() = default;
  void declare(Fields fields) { declare_stream(default_stream, std::move(fields), false); }
  /// \param direct true: tuples of this stream are emitted with emit_direct(), which names the task that gets them.
  virtual void declare_stream(const std::string& stream, Fields fields, bool direct = false) = 0;
};

/// The id that a spout gives a tracked tuple; ack() and fail() get it back.
using MessageId = std::uint64_t;

/// Is told what happens to the tuples of one message. The runtime calls it on its threads; a call is short, and throws
/// nothing. Times are nanoseconds of the topology's clock; a tuple's address names it until it is settled. Thread safe.
class TupleTrace {
 public:
  virtual ~TupleTrace() = default;
  /// A task has emitted a tuple.
  virtual void emitted(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t at_ns) noexcept = 0;
  /// A bolt's task has executed a tuple.
  virtual void executed(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t begin_ns,
                        std::int64_t end_ns) noexcept = 0;
  /// A bolt's task has acked a tuple, or failed it. Only the first call of a tuple counts.
  virtual void settled(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t at_ns,
                       bool acked) noexcept = 0;
};

/// Where messages of a spout come from, such as a reader at a broker. Thread safe.
class TupleOrigin {
 public:
  virtual ~TupleOrigin() = default;
  /// Whether its messages come again by themselves, here or to another reader, so that nobody waits for their tuples
  /// any more. Once it is true it stays so.
  virtual bool comes_again() const = 0;
  /// What is told of the message's tuples while Runtime::trace() is on; nullptr: nothing. It lives as long as this.
  virtual TupleTrace* trace() const { return nullptr; }
};

/// How a spout emits. Only the spout's own calls may use it. emit never blocks and never drops a tuple; it throws
/// std::invalid_argument for values that do not fit the stream's fields.
class SpoutOutputCollector {
 public:
  virtual ~SpoutOutputCollector() = default;
  void emit(Values values) { do_emit(default_stream, std::move(values), no_task, nullptr); }
  /// Emits a tracked tuple: the runtime calls the spout's ack(id) when the whole tree of tuples was acked, or fail(id)
  /// when one of them failed or the message time-out passed.
  void emit(Values values, MessageId id) { do_emit(default_stream, std::move(values), no_task, &id); }
  void emit_to(std::string_view stream, Values values) { do_emit(stream, std::move(values), no_task, nullptr); }
  void emit_to(std::string_view stream, Values values, MessageId id) {
    do_emit(stream, std::move(values), no_task, &id);
  }
  /// The same; the tuples of its tree are void once the message comes again (OutputCollector::is_void()).
  void emit_to(std::string_view stream, Values values, MessageId id, std::shared_ptr<const TupleOrigin> origin) {
    do_emit_from(std::move(origin), stream, std::move(values), id);
  }
  void emit_direct(int task, std::string_view stream, Values values) {
    do_emit(stream, std::move(values), task, nullptr);
  }
  void emit_direct(int task, std::string_view stream, Values values, MessageId id) {
    do_emit(stream, std::move(values), task, &id);
  }
  virtual void report_error(const std::string& text) = 0;

 protected:
  static constexpr int no_task = -1;  ///< for `task`: the groupings choose the receivers
  /// \param id nullptr: not tracked.
  virtual void do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) = 0;
  // NOLINTNEXTLINE(performance-unnecessary-value-param): what keeps the origin moves it
  virtual void do_emit_from(std::shared_ptr<const TupleOrigin> origin, std::string_view stream, Values&& values,
                            MessageId id) {
    (void)origin;
    do_emit(stream, std::move(values), no_task, &id);
  }
};

/// How a bolt emits. Only the bolt's own calls may emit; any thread may call ack, fail, retry and reset_timeout.
class OutputCollector {
 public:
  virtual ~OutputCollector() = default;
  /// Emits a tuple that is anchored to another one: if the new tuple fails, the anchor's tree fails.
  void emit(const Tuple& anchor, Values values) { do_emit(default_stream, {&anchor, 1}, std::move(values), no_task); }
  void emit(std::span<const Tuple> anchors, Values values) {
    do_emit(default_stream, anchors, std::move(values), no_task);
  }
  /// Emits a tuple without an anchor: no spout learns whether it was processed.
  void emit(Values values) { do_emit(default_stream, {}, std::move(values), no_task); }
  void emit_to(std::string_view stream, std::span<const Tuple> anchors, Values values) {
    do_emit(stream, anchors, std::move(values), no_task);
  }
  void emit_direct(int task, std::string_view stream, std::span<const Tuple> anchors, Values values) {
    do_emit(stream, anchors, std::move(values), task);
  }

  /// Says that this bolt is done with the tuple. A bolt acks or fails each tuple that it received once.
  virtual void ack(const Tuple& tuple) = 0;
  /// Fails the tuple's tree: the runtime calls the spout's fail() soon, without waiting for the rest of the tree.
  virtual void fail(const Tuple& tuple) = 0;
  /// Fails the tuple's tree as fail() does, but not because of the tuple: the runtime calls the spout's retry().
  virtual void retry(const Tuple& tuple) { fail(tuple); }
  /// Whether a message from which the tuple comes is not this worker's any more (TupleOrigin::comes_again()): another
  /// one gets it, and may be ahead. A bolt that changes what other workers change too should retry() such a tuple. Only
  /// the bolt's own calls may ask it. False for a tuple that it has acked or failed, for one that is not tracked, and
  /// on Storm.
  virtual bool is_void(const Tuple& tuple) const {
    (void)tuple;
    return false;
  }
  /// Restarts the time-out of the tuple's tree.
  virtual void reset_timeout(const Tuple& tuple) = 0;
  virtual void report_error(const std::string& text) = 0;

 protected:
  friend class BasicOutputCollector;  // does not move the values once more
  static constexpr int no_task = -1;  ///< for `task`: the groupings choose the receivers
  virtual void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) = 0;
};

}  // namespace iotcloud::topology
