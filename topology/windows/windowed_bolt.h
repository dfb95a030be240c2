#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/topology_builder.h>
#include <iotcloud/topology/windows/window_options.h>

namespace iotcloud::topology {

/// The tuples of one evaluation, valid during it, in order of their time stamps (event time) or of arrival.
class TupleWindow {
 public:
  TupleWindow(std::span<const Tuple> tuples, std::span<const Tuple> added, std::span<const Tuple> expired,
              std::int64_t begin_ms, std::int64_t end_ms)
      : tuples_(tuples), added_(added), expired_(expired), begin_ms_(begin_ms), end_ms_(end_ms) {}
  std::span<const Tuple> tuples() const { return tuples_; }  ///< never empty
  std::span<const Tuple> added() const { return added_; }    ///< the tuples that were in no earlier window
  /// Tuples of earlier windows that are in no later one.
  std::span<const Tuple> expired() const { return expired_; }
  /// In milliseconds since 1970. For a length in time the window's borders (the end is outside), otherwise the times of
  /// its first and last tuple.
  std::int64_t begin_ms() const { return begin_ms_; }
  std::int64_t end_ms() const { return end_ms_; }

 private:
  std::span<const Tuple> tuples_, added_, expired_;
  std::int64_t begin_ms_, end_ms_;
};

/// How a windowed bolt emits, anchored to all tuples of the current window. Use it in execute() only.
class WindowOutputCollector {
 public:
  virtual ~WindowOutputCollector() = default;
  void emit(Values values) { emit_to(default_stream, std::move(values)); }
  virtual void emit_to(std::string_view stream, Values values) = 0;
  virtual void report_error(const std::string& text) = 0;
};

/// A bolt that works on windows of tuples instead of single ones (Storm's BaseWindowedBolt). It does not ack: a tuple
/// is acked when no later window can contain it. If execute() throws, all tuples of the window fail, and no later
/// window contains them. So tuples stay unacked for longest_hold(): keep the message time-out well above
/// that (a topology file that does not is refused). If the process ends, spouts emit the tuples of its windows again.
class WindowedBolt {
 public:
  virtual ~WindowedBolt() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// `context` and `collector` live until after cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context, WindowOutputCollector& collector) = 0;
  virtual void execute(const TupleWindow& window) = 0;
  virtual void cleanup() {}
};

/// Wraps a windowed bolt as a Bolt, which asks for the ticks that it needs.
std::unique_ptr<Bolt> run_windowed(std::unique_ptr<WindowedBolt> bolt, WindowOptions options);

/// For TopologyBuilder::set_bolt: `set_bolt("mean", make_windowed_bolt<Mean>({.length = 10s, .slide = 1s}), 4)`.
/// TopologyBuilder::build() refuses options that make no windows.
template <typename T, typename... Args>
BoltFactory make_windowed_bolt(WindowOptions options, Args... args) {
  return [options = std::move(options), args...] { return run_windowed(std::make_unique<T>(args...), options); };
}

}  // namespace iotcloud::topology
