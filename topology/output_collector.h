#pragma once

#include <cstdint>
#include <span>
#include <string>
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
  void emit(Values values) { emit_to(default_stream, std::move(values)); }
  /// Tracked: ack(id) when the whole tree of tuples was acked, fail(id) when one failed or the time-out passed.
  void emit(Values values, MessageId id) { emit_to(default_stream, std::move(values), id); }
  virtual void emit_to(const std::string& stream, Values values) = 0;
  virtual void emit_to(const std::string& stream, Values values, MessageId id) = 0;
  virtual void emit_direct(int task, const std::string& stream, Values values, MessageId id) = 0;
  virtual void report_error(const std::string& text) = 0;
};

/// How a bolt emits. emit: from the bolt's own calls only. ack, fail and reset_timeout: from any thread.
class OutputCollector {
 public:
  virtual ~OutputCollector() = default;
  /// Anchored by one tuple: if the new one fails, so does the anchor's tree.
  void emit(const Tuple& anchor, Values values) { emit_to(default_stream, {&anchor, 1}, std::move(values)); }
  void emit(std::span<const Tuple> anchors, Values values) { emit_to(default_stream, anchors, std::move(values)); }
  /// Not anchored: nobody hears of it again.
  void emit(Values values) { emit_to(default_stream, {}, std::move(values)); }
  virtual void emit_to(const std::string& stream, std::span<const Tuple> anchors, Values values) = 0;
  virtual void emit_direct(int task, const std::string& stream, std::span<const Tuple> anchors, Values values) = 0;

  virtual void ack(const Tuple& tuple) = 0;
  virtual void fail(const Tuple& tuple) = 0;
  /// The time-out of the tuple's tree starts anew.
  virtual void reset_timeout(const Tuple& tuple) = 0;
  virtual void report_error(const std::string& text) = 0;
};

}  // namespace iotcloud::topology
