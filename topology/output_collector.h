#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/tuple.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

/// Where a component says which streams it emits, before the topology runs.
class OutputFieldsDeclarer {
 public:
  virtual ~OutputFieldsDeclarer() = default;
  void declare(Fields fields) { declare_stream(default_stream, std::move(fields), false); }
  /// \param direct tuples of this stream go where emit_direct says.
  virtual void declare_stream(const std::string& stream, Fields fields, bool direct = false) = 0;
};

/// The id by which a spout knows a tuple that it wants to hear of again (ack or fail).
using MessageId = std::uint64_t;

/// How a spout emits. Use it from the spout's own calls only. emit never blocks and never drops.
/// Values that do not fit the stream's fields throw std::invalid_argument.
class SpoutOutputCollector {
 public:
  virtual ~SpoutOutputCollector() = default;
  void emit(Values values) { do_emit(default_stream, std::move(values), no_task, nullptr); }
  /// Tracked: ack(id) when the whole tree of tuples was acked, fail(id) when one failed or the time-out passed.
  void emit(Values values, MessageId id) { do_emit(default_stream, std::move(values), no_task, &id); }
  void emit_to(std::string_view stream, Values values) { do_emit(stream, std::move(values), no_task, nullptr); }
  void emit_to(std::string_view stream, Values values, MessageId id) {
    do_emit(stream, std::move(values), no_task, &id);
  }
  void emit_direct(int task, std::string_view stream, Values values) {
    do_emit(stream, std::move(values), task, nullptr);
  }
  void emit_direct(int task, std::string_view stream, Values values, MessageId id) {
    do_emit(stream, std::move(values), task, &id);
  }
  virtual void report_error(const std::string& text) = 0;

 protected:
  static constexpr int no_task = -1;  ///< the groupings choose
  /// \param id nullptr: not tracked.
  virtual void do_emit(std::string_view stream, Values&& values, int task, const MessageId* id) = 0;
};

/// How a bolt emits. emit: from the bolt's own calls only. ack, fail and reset_timeout: from any thread.
class OutputCollector {
 public:
  virtual ~OutputCollector() = default;
  /// Anchored by one tuple: if the new one fails, so does the anchor's tree.
  void emit(const Tuple& anchor, Values values) { do_emit(default_stream, {&anchor, 1}, std::move(values), no_task); }
  void emit(std::span<const Tuple> anchors, Values values) {
    do_emit(default_stream, anchors, std::move(values), no_task);
  }
  /// Not anchored: nobody hears of it again.
  void emit(Values values) { do_emit(default_stream, {}, std::move(values), no_task); }
  void emit_to(std::string_view stream, std::span<const Tuple> anchors, Values values) {
    do_emit(stream, anchors, std::move(values), no_task);
  }
  void emit_direct(int task, std::string_view stream, std::span<const Tuple> anchors, Values values) {
    do_emit(stream, anchors, std::move(values), task);
  }

  virtual void ack(const Tuple& tuple) = 0;
  virtual void fail(const Tuple& tuple) = 0;
  /// The time-out of the tuple's tree starts anew.
  virtual void reset_timeout(const Tuple& tuple) = 0;
  virtual void report_error(const std::string& text) = 0;

 protected:
  static constexpr int no_task = -1;  ///< the groupings choose
  virtual void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) = 0;
};

}  // namespace iotcloud::topology
