#pragma once

#include <chrono>
#include <memory>
#include <type_traits>
#include <utility>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// Processes tuples. The runtime never makes two calls to one task at the same time, but successive calls may come on
/// different threads. If execute() throws, the runtime fails the tuple, and counts and logs the error with component
/// and task; the process goes on.
class Bolt {
 public:
  virtual ~Bolt() = default;
  /// Declares the streams that the bolt emits; none by default (a sink).
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// `context` and `collector` live until after cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) = 0;
  /// Acks or fails the tuple, now or later. Ticks (Tuple::is_tick) arrive here too.
  virtual void execute(const Tuple& tuple) = 0;
  virtual void cleanup() {}  ///< the last call, when the topology ends; not made after a crash of the process
  /// How often the bolt wants a tick if the topology sets no period (BoltDeclarer::tick); 0: never.
  /// TopologyBuilder::build() calls it once for each component. \param config as in prepare().
  virtual std::chrono::microseconds tick_period(const Config& config) const {
    (void)config;
    return std::chrono::microseconds{0};
  }
  /// holds_tuples_for(): until enough other tuples have come, however long that takes.
  static constexpr std::chrono::microseconds until_others_come = std::chrono::microseconds::max();
  /// For how long the bolt keeps a tuple, by design, before it acks it (a window); until_others_come; or 0: it does not
  /// say. A topology whose bolts keep tuples for a time longer than the message time-out is refused.
  /// TopologyBuilder::build() calls it once for each component. \param config as in prepare().
  virtual std::chrono::microseconds holds_tuples_for(const Config& config) const {
    (void)config;
    return std::chrono::microseconds{0};
  }
};

/// Emits for a BasicBolt, anchored to the tuple that it executes.
class BasicOutputCollector {
 public:
  BasicOutputCollector(OutputCollector& collector, const Tuple& input) : collector_(collector), input_(input) {}
  /// \throws std::invalid_argument for values that do not fit the stream's fields.
  void emit(Values values) { emit_to(default_stream, std::move(values)); }
  void emit_to(std::string_view stream, Values&& values) {
    collector_.do_emit(stream, {&input_, 1}, std::move(values), OutputCollector::no_task);
  }
  void emit_to(std::string_view stream, const Values& values) { emit_to(stream, Values(values)); }
  /// Counts and logs an error of this task, and keeps its text for the snapshot; the tuple does not fail.
  void report_error(const std::string& text) { collector_.report_error(text); }

 private:
  OutputCollector& collector_;
  const Tuple& input_;
};

/// A bolt that is done with a tuple when execute() returns: what it emits is anchored to that tuple, and the runtime
/// acks the tuple after execute() returned, or fails it if execute() threw. make_bolt() makes a Bolt of it.
class BasicBolt {
 public:
  virtual ~BasicBolt() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// Called once, before the first tuple. If it throws, the topology does not start. `context` lives until after
  /// cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context) { (void)config, (void)context; }
  /// `collector` lives during the call only. Ticks (Tuple::is_tick) arrive here too.
  virtual void execute(const Tuple& tuple, BasicOutputCollector& collector) = 0;
  virtual void cleanup() {}
};

namespace detail {

/// Wraps a BasicBolt as a Bolt.
class BasicBoltExecutor : public Bolt {
 public:
  explicit BasicBoltExecutor(std::unique_ptr<BasicBolt> basic) : basic_(std::move(basic)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { basic_->declare_output_fields(declarer); }
  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override {
    collector_ = &collector;
    basic_->prepare(config, context);
  }
  void execute(const Tuple& tuple) override {
    BasicOutputCollector basic(*collector_, tuple);
    basic_->execute(tuple, basic);
    collector_->ack(tuple);
  }
  void cleanup() override { basic_->cleanup(); }

 private:
  std::unique_ptr<BasicBolt> basic_;
  OutputCollector* collector_ = nullptr;
};

/// A class that checks its configuration before a topology starts.
template <typename T>
concept ChecksConf = requires(const Config& config) {
  T::check_conf(config);
};

/// Asks the class to check its configuration when the topology asks the bolt for its ticks.
template <ChecksConf T>
class CheckedBasicBoltExecutor final : public BasicBoltExecutor {
 public:
  using BasicBoltExecutor::BasicBoltExecutor;
  std::chrono::microseconds tick_period(const Config& config) const override {
    T::check_conf(config);
    return BasicBoltExecutor::tick_period(config);
  }
};

}  // namespace detail

/// Makes a Bolt of class T; a T that is a BasicBolt is wrapped. Such a T may have `static void check_conf(const
/// Config&)`, which throws what is wrong with the configuration (ConfCheck in conf_keys.h): the check of the topology's
/// file says it, and so does the start. A T that is a Bolt throws it in tick_period().
template <typename T, typename... Args>
std::unique_ptr<Bolt> make_bolt(Args&&... args) {
  if constexpr (std::is_base_of_v<BasicBolt, T> && detail::ChecksConf<T>) {
    return std::make_unique<detail::CheckedBasicBoltExecutor<T>>(std::make_unique<T>(std::forward<Args>(args)...));
  } else if constexpr (std::is_base_of_v<BasicBolt, T>) {
    return std::make_unique<detail::BasicBoltExecutor>(std::make_unique<T>(std::forward<Args>(args)...));
  } else {
    return std::make_unique<T>(std::forward<Args>(args)...);
  }
}

}  // namespace iotcloud::topology
