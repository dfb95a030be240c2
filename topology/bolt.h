#pragma once

#include <chrono>
#include <memory>
#include <type_traits>
#include <utility>

#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// Processes tuples. All calls of one task are serial, though not always on the same thread. An exception from execute
/// fails the tuple and is counted and reported with component and task; the process lives.
class Bolt {
 public:
  virtual ~Bolt() = default;
  /// What it emits; nothing by default (a sink).
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// `context` and `collector` live until after cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) = 0;
  /// Acks or fails the tuple, now or later. Ticks (Tuple::is_tick) come here too.
  virtual void execute(const Tuple& tuple) = 0;
  virtual void cleanup() {}
  /// How often it wants a tick when the topology names no period (BoltDeclarer::tick); 0: never. Asked once, by
  /// TopologyBuilder::build(). \param config as in prepare().
  virtual std::chrono::microseconds tick_period(const Config& config) const {
    (void)config;
    return std::chrono::microseconds{0};
  }
};

/// Emits on behalf of a BasicBolt: anchored by the tuple in hand.
class BasicOutputCollector {
 public:
  BasicOutputCollector(OutputCollector& collector, const Tuple& input) : collector_(collector), input_(input) {}
  void emit(Values values) { collector_.emit(input_, std::move(values)); }
  void emit_to(std::string_view stream, Values values) { collector_.emit_to(stream, {&input_, 1}, std::move(values)); }
  void report_error(const std::string& text) { collector_.report_error(text); }

 private:
  OutputCollector& collector_;
  const Tuple& input_;
};

/// A bolt that is done with a tuple when execute returns: what it emits is anchored, the tuple is acked by itself, and
/// failed when execute throws. Used wherever a Bolt is.
class BasicBolt {
 public:
  virtual ~BasicBolt() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  virtual void prepare(const Config& config, const TopologyContext& context) { (void)config, (void)context; }
  virtual void execute(const Tuple& tuple, BasicOutputCollector& collector) = 0;
  virtual void cleanup() {}
};

namespace detail {

/// Runs a BasicBolt as a Bolt.
class BasicBoltExecutor final : public Bolt {
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

}  // namespace detail

/// Makes a T, which is a Bolt or a BasicBolt, as a Bolt.
template <typename T, typename... Args>
std::unique_ptr<Bolt> make_bolt(Args&&... args) {
  if constexpr (std::is_base_of_v<BasicBolt, T>) {
    return std::make_unique<detail::BasicBoltExecutor>(std::make_unique<T>(std::forward<Args>(args)...));
  } else {
    return std::make_unique<T>(std::forward<Args>(args)...);
  }
}

}  // namespace iotcloud::topology
