#include <optional>
#include <stdexcept>

#include <iotcloud/topology/windows/watermarks.h>
#include <iotcloud/topology/windows/window_buffer.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology {

namespace {

using internal::Watermarks;
using internal::WindowBuffer;

std::int64_t as_ms(config::Clock::Instant instant) {
  return std::chrono::floor<std::chrono::milliseconds>(instant.time_since_epoch()).count();
}

/// Runs a WindowedBolt as a Bolt: collects tuples, keeps time, and settles released tuples, like Storm's
/// WindowedBoltExecutor.
class WindowedBoltExecutor final : public Bolt, private WindowBuffer::Listener, private WindowOutputCollector {
 public:
  WindowedBoltExecutor(std::unique_ptr<WindowedBolt> bolt, WindowOptions options)
      : bolt_(std::move(bolt)), options_(std::move(options)) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    bolt_->declare_output_fields(declarer);
    if (!options_.late_stream.empty()) declarer.declare_stream(options_.late_stream, options_.late_fields);
  }

  std::chrono::microseconds tick_period(const Config& config) const override {
    const WindowOptions options = configured(options_, config);
    if (!options.event_time()) return options.slide.duration;
    return options.watermark_interval.count() > 0 ? options.watermark_interval : options.idle_source;
  }

  std::chrono::microseconds holds_tuples_for(const Config& config) const override {
    return longest_hold(configured(options_, config));
  }

  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override {
    options_ = configured(std::move(options_), config);
    collector_ = &collector;
    clock_ = context.clock;
    holdings_ = context.holdings;
    wall_offset_ms_ = clock_->wall_ms() - as_ms(clock_->now());
    const std::int64_t now = now_ms();
    buffer_.emplace(options_.length, options_.slide, options_.event_time() ? 0 : now);
    watermarks_.emplace(context.inputs.size(), options_.lag.count(), options_.idle_source.count(), now);
    const config::Labels labels{
        {"topology", context.topology}, {"component", context.component}, {"task", std::to_string(context.task)}};
    windows_ = &context.metrics->counter("iotcloud_task_windows_total", "Windows evaluated", labels);
    late_ =
        &context.metrics->counter("iotcloud_task_window_late_total", "Tuples that came after the watermark", labels);
    bolt_->prepare(config, context, *this);
  }

  void execute(const Tuple& tuple) override {
    take(tuple);
    if (holdings_ != nullptr)
      holdings_->window_tuples.store(static_cast<std::int64_t>(buffer_->size()), std::memory_order_relaxed);
  }

  void cleanup() override { bolt_->cleanup(); }

 private:
  void take(const Tuple& tuple) {
    const std::int64_t now = now_ms();
    if (!options_.event_time()) {
      buffer_->advance(now, *this);
      if (tuple.is_tick()) return;
      buffer_->add(now, tuple);
      if (options_.slide.counts()) buffer_->advance(now, *this);
      return;
    }
    if (tuple.is_tick()) {
      move_on(now);
      return;
    }
    const std::int64_t time =
        options_.timestamp ? options_.timestamp(tuple) : tuple.get<std::int64_t>(options_.timestamp_field);
    if (watermarks_->late(time)) {
      give_up(tuple);
      return;
    }
    buffer_->add(time, tuple);
    watermarks_->heard(tuple, time, now);
    if (options_.watermark_interval.count() == 0) move_on(now);
  }

  /// Milliseconds since 1970 by the monotonic clock, so that steps of the wall clock do not move windows.
  std::int64_t now_ms() const { return as_ms(clock_->now()) + wall_offset_ms_; }

  void move_on(std::int64_t now) {
    if (const auto watermark = watermarks_->update(now)) buffer_->advance(*watermark, *this);
  }

  void give_up(const Tuple& tuple) {
    late_->add();
    if (!options_.late_stream.empty()) {
      Values values;
      for (const std::string& field : options_.late_fields) {
        values.add(tuple.has(field) ? Value(tuple.at(field)) : Value());
      }
      collector_->emit_to(options_.late_stream, {&tuple, 1}, std::move(values));
    }
    collector_->ack(tuple);
  }

  // The window buffer calls it. What the user's bolt throws is caught here, because the tuple that execute() handles
  // may be in another window, and must not fail.
  bool evaluate(const TupleWindow& window) override {
    windows_->add();
    anchors_ = window.tuples();
    bool good = false;
    try {
      bolt_->execute(window);
      good = true;
    } catch (const std::exception& e) {
      collector_->report_error(std::string("execute() of a window threw: ") + e.what());
    } catch (...) {
      collector_->report_error("execute() of a window threw something that is no std::exception");
    }
    anchors_ = {};
    return good;
  }
  void done(const Tuple& tuple) override { collector_->ack(tuple); }
  void failed(const Tuple& tuple) override { collector_->fail(tuple); }

  // The user's bolt calls it to emit.
  void emit_to(std::string_view stream, Values values) override {
    if (anchors_.empty()) {
      throw std::logic_error("a windowed bolt emits in execute() only: there is no window to anchor to elsewhere");
    }
    collector_->emit_to(stream, anchors_, std::move(values));
  }
  void report_error(const std::string& text) override { collector_->report_error(text); }

  const std::unique_ptr<WindowedBolt> bolt_;
  WindowOptions options_;
  OutputCollector* collector_ = nullptr;
  const config::Clock* clock_ = nullptr;
  Holdings* holdings_ = nullptr;
  std::int64_t wall_offset_ms_ = 0;
  std::optional<WindowBuffer> buffer_;
  std::optional<Watermarks> watermarks_;
  std::span<const Tuple> anchors_;  ///< tuples of the current window
  config::Counter* windows_ = nullptr;
  config::Counter* late_ = nullptr;
};

}  // namespace

std::unique_ptr<Bolt> run_windowed(std::unique_ptr<WindowedBolt> bolt, WindowOptions options) {
  return std::make_unique<WindowedBoltExecutor>(std::move(bolt), std::move(options));
}

}  // namespace iotcloud::topology
