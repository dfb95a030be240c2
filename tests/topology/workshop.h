#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/runtime/complete_topology.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/topology_builder.h>

/// Spouts and bolts from which tests build topologies; the tasks of a component share the objects around them.
namespace iotcloud::topology::workshop {

using namespace std::chrono_literals;

using tests::eventually;

/// Gives a SourceSpout the tuples to emit, and collects its calls.
class Source {
 public:
  void put(Values values) {
    {
      const std::lock_guard lock(mutex_);
      waiting_.push_back(std::move(values));
    }
    waker_.wake();
  }
  /// Puts a tuple without waking the spout.
  void lay(Values values) {
    const std::lock_guard lock(mutex_);
    waiting_.push_back(std::move(values));
  }
  void wake() const { waker_.wake(); }
  std::size_t waiting() const {
    const std::lock_guard lock(mutex_);
    return waiting_.size();
  }
  std::vector<MessageId> acked() const {
    const std::lock_guard lock(mutex_);
    return acked_;
  }
  std::vector<MessageId> failed() const {
    const std::lock_guard lock(mutex_);
    return failed_;
  }
  /// Those of failed() for which nobody blames the message.
  std::vector<MessageId> retried() const {
    const std::lock_guard lock(mutex_);
    return retried_;
  }
  std::vector<std::string> calls() const {
    const std::lock_guard lock(mutex_);
    return calls_;
  }
  /// Where the tuples that are emitted from now on come from.
  void come_from(std::shared_ptr<const TupleOrigin> origin) {
    const std::lock_guard lock(mutex_);
    origin_ = std::move(origin);
  }
  bool tracked = true;

 private:
  friend class SourceSpout;
  void note(const char* call) {
    const std::lock_guard lock(mutex_);
    calls_.emplace_back(call);
  }
  mutable std::mutex mutex_;
  SpoutWaker waker_;
  std::deque<Values> waiting_;
  std::vector<MessageId> acked_, failed_, retried_;
  std::vector<std::string> calls_;
  MessageId next_id_ = 0;
  std::shared_ptr<const TupleOrigin> origin_;
};

/// Its messages come again once the test says so.
class Reader final : public TupleOrigin {
 public:
  bool comes_again() const override { return gone; }
  std::atomic<bool> gone{false};
};

/// Emits the tuples of its Source, tracked with ids 1, 2, 3, ...
class SourceSpout : public Spout {
 public:
  SourceSpout(std::shared_ptr<Source> source, Fields fields) : source_(std::move(source)), fields_(std::move(fields)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(fields_); }
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    const std::lock_guard lock(source_->mutex_);
    source_->waker_ = context.waker;
    source_->calls_.emplace_back("open");
  }
  void activate() override { source_->note("activate"); }
  void deactivate() override { source_->note("deactivate"); }
  void close() override { source_->note("close"); }
  void throttled(bool on) override { source_->note(on ? "throttled" : "unthrottled"); }
  bool next_tuple() override {
    Values values;
    MessageId id = 0;
    std::shared_ptr<const TupleOrigin> origin;
    {
      const std::lock_guard lock(source_->mutex_);
      if (source_->waiting_.empty()) return false;
      values = std::move(source_->waiting_.front());
      source_->waiting_.pop_front();
      id = ++source_->next_id_;
      origin = source_->origin_;
    }
    if (origin) {
      collector_->emit_to(default_stream, std::move(values), id, std::move(origin));
    } else if (source_->tracked) {
      collector_->emit(std::move(values), id);
    } else {
      collector_->emit(std::move(values));
    }
    return true;
  }
  void ack(MessageId id) override {
    const std::lock_guard lock(source_->mutex_);
    source_->acked_.push_back(id);
  }
  void fail(MessageId id) override {
    const std::lock_guard lock(source_->mutex_);
    source_->failed_.push_back(id);
  }
  void retry(MessageId id) override {
    fail(id);
    const std::lock_guard lock(source_->mutex_);
    source_->retried_.push_back(id);
  }

 private:
  std::shared_ptr<Source> source_;
  Fields fields_;
  SpoutOutputCollector* collector_ = nullptr;
};

inline SpoutFactory source_spout(const std::shared_ptr<Source>& source, const Fields& fields = {"value"}) {
  return [source, fields] { return std::make_unique<SourceSpout>(source, fields); };
}

/// A bolt that calls a function; the function must ack and emit.
class FunctionBolt : public Bolt {
 public:
  using Execute = std::function<void(const Tuple&, OutputCollector&, const TopologyContext&)>;
  FunctionBolt(Execute execute, Fields fields) : execute_(std::move(execute)), fields_(std::move(fields)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    if (!fields_.empty()) declarer.declare(fields_);
  }
  void prepare(const Config&, const TopologyContext& context, OutputCollector& collector) override {
    context_ = &context;
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override { execute_(tuple, *collector_, *context_); }

 private:
  Execute execute_;
  Fields fields_;
  const TopologyContext* context_ = nullptr;
  OutputCollector* collector_ = nullptr;
};

inline BoltFactory bolt(const FunctionBolt::Execute& execute, const Fields& fields = {}) {
  return [execute, fields] { return std::make_unique<FunctionBolt>(execute, fields); };
}

/// Acks all tuples, and keeps them by task.
struct Sink {
  struct Item {
    int task;
    std::thread::id thread;
    std::vector<Value> values;
  };
  void add(const Tuple& tuple, int task) {
    const std::lock_guard lock(mutex);
    items.push_back({task, std::this_thread::get_id(), {}});
    for (std::size_t i = 0; i < tuple.size(); ++i) items.back().values.push_back(tuple.at(i));
  }
  std::size_t size() const {
    const std::lock_guard lock(mutex);
    return items.size();
  }
  std::vector<std::int64_t> numbers() const {
    const std::lock_guard lock(mutex);
    std::vector<std::int64_t> list;
    for (const Item& item : items) list.push_back(std::get<std::int64_t>(item.values.at(0)));
    return list;
  }
  mutable std::mutex mutex;
  std::vector<Item> items;
};

inline BoltFactory sink_bolt(const std::shared_ptr<Sink>& sink) {
  return bolt([sink](const Tuple& tuple, OutputCollector& collector, const TopologyContext& context) {
    sink->add(tuple, context.task_index);
    collector.ack(tuple);
  });
}

/// Passes tuples on unchanged, anchored.
inline BoltFactory pass_bolt(const Fields& fields = {"value"}) {
  return bolt(
      [](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
        Values values;
        for (std::size_t i = 0; i < tuple.size(); ++i) values.add(tuple.at(i));
        collector.emit(tuple, std::move(values));
        collector.ack(tuple);
      },
      fields);
}

/// Options for a runtime without threads and with simulated time.
struct Bench {
  SimulatedClock clock;
  config::Metrics metrics;
  RuntimeOptions options() {
    RuntimeOptions all;
    all.threads = 0;
    all.clock = &clock;
    all.metrics = &metrics;
    return all;
  }
};

}  // namespace iotcloud::topology::workshop
