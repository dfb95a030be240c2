#pragma once

#include <chrono>

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
};

/// Emits on behalf of a BasicBolt: anchored by the tuple in hand.
class BasicOutputCollector {
 public:
  BasicOutputCollector(OutputCollector& collector, const Tuple& input) : collector_(collector), input_(input) {}
  void emit(Values values) { collector_.emit(input_, std::move(values)); }
  void emit_to(const std::string& stream, Values values) {
    collector_.emit_to(stream, {&input_, 1}, std::move(values));
  }
  void report_error(const std::string& text) { collector_.report_error(text); }

 private:
  OutputCollector& collector_;
  const Tuple& input_;
};

/// A bolt that is done with a tuple when execute returns: anchors and acks by itself, fails the tuple when execute
/// throws.
class BasicBolt : public Bolt {
 public:
  virtual void prepare(const Config& config, const TopologyContext& context) { (void)config, (void)context; }
  virtual void execute(const Tuple& tuple, BasicOutputCollector& collector) = 0;

  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) final {
    collector_ = &collector;
    prepare(config, context);
  }
  void execute(const Tuple& tuple) final {
    BasicOutputCollector basic(*collector_, tuple);
    execute(tuple, basic);
    collector_->ack(tuple);
  }

 private:
  OutputCollector* collector_ = nullptr;
};

}  // namespace iotcloud::topology
