#pragma once

#include <chrono>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// A source of tuples. All calls of one task are serial, though not always on the same thread. An exception is counted
/// and reported with component and task; the process lives.
class Spout {
 public:
  virtual ~Spout() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const = 0;
  /// `context` and `collector` live until after close().
  virtual void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) = 0;
  virtual void activate() {}
  virtual void deactivate() {}
  virtual void close() {}
  /// Emits what is there, one tuple preferably, and must not block. \return true when there may be more at once; false:
  /// call again when woken (SpoutWaker) or, with a poll period, later. Not called while too much is under way.
  virtual bool next_tuple() = 0;
  virtual void ack(MessageId id) { (void)id; }
  virtual void fail(MessageId id) { (void)id; }
  /// More than zero: next_tuple is tried this long after it returned false, for sources that cannot wake.
  virtual std::chrono::microseconds poll_period() const { return std::chrono::microseconds{0}; }
  /// Back pressure: called with true when the task may not emit for now, with false when it may again.
  virtual void throttled(bool on) { (void)on; }
};

}  // namespace iotcloud::topology
