#pragma once

#include <chrono>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// A source of tuples. The runtime never makes two calls to one task at the same time, but successive calls may come on
/// different threads. If a call throws, the runtime counts and logs the error with component and task; the process goes
/// on.
class Spout {
 public:
  virtual ~Spout() = default;
  /// Declares the streams that the spout emits. TopologyBuilder::build() calls it on an object that it makes for this
  /// question and that never runs.
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const = 0;
  /// `context` and `collector` live until after close().
  virtual void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) = 0;
  /// Called after open(), and when the topology goes on after a pause.
  virtual void activate() {}
  /// Called when the topology pauses or ends; the runtime does not call next_tuple() until activate().
  virtual void deactivate() {}
  virtual void close() {}  ///< the last call
  /// Emits what is available, preferably one tuple, without blocking. The runtime does not call it while
  /// max_spout_pending tracked tuples are under way or a receiver's mailbox is full. \return true if there may be more
  /// now; false: the runtime calls again when a SpoutWaker wakes the task, after poll_period(), or after fail() or
  /// retry(); not after ack(): a spout that limits by itself what is under way calls wake() in its ack().
  virtual bool next_tuple() = 0;
  /// All tuples of the tree of message `id` were acked. Each tracked tuple gets one ack(), fail() or retry().
  virtual void ack(MessageId id) { (void)id; }
  /// A tuple of the tree of message `id` failed, or the message time-out passed. Emitting the message again is up to
  /// the spout.
  virtual void fail(MessageId id) { (void)id; }
  /// As fail(), but nothing is wrong with the message (OutputCollector::retry()): a spout that gives up a message after
  /// some tries should not count this one. Storm calls fail() instead.
  virtual void retry(MessageId id) { fail(id); }
  /// If positive, the runtime calls next_tuple this long after it returned false, for sources that cannot wake it.
  virtual std::chrono::microseconds poll_period() const { return std::chrono::microseconds{0}; }
  /// Back pressure: called with true when the runtime stops calling next_tuple() because a receiver's mailbox is full
  /// or too many tracked tuples are under way, with false when it calls again.
  virtual void throttled(bool on) { (void)on; }
};

}  // namespace iotcloud::topology
