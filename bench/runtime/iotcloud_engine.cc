// The DAGs on IoTCloud's own runtime, written as a user of the SDK writes a topology.
#include <array>

#include <iotcloud/bench/runtime/iotcloud_engine.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::bench {

namespace {

using topology::BasicBolt;
using topology::BasicOutputCollector;
using topology::Config;
using topology::Fields;
using topology::MessageId;
using topology::OutputFieldsDeclarer;
using topology::Payload;
using topology::SpoutOutputCollector;
using topology::TopologyContext;
using topology::Tuple;
using topology::Values;

std::uint64_t item_of(const Tuple& tuple, std::size_t field) {
  return static_cast<std::uint64_t>(tuple.get<std::int64_t>(field));
}

/// Whether a word has its item's number, by which it is timed.
bool is_numbered(const Workload& work) {
  return work.feed.paced() || work.options.numbered;
}

/// Emits the items that are due according to the feed.
class Source : public topology::Spout {
 public:
  /// \param wakers by task.
  Source(Workload& work, std::array<topology::SpoutWaker, 2>& wakers) : work_(work), wakers_(wakers) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    switch (work_.options.dag) {
      case Dag::words:
        return declarer.declare(is_numbered(work_) ? Fields{"sentence", "n"} : Fields{"sentence"});
      case Dag::payload:
        return declarer.declare({"payload", "n"});
      default:
        return declarer.declare({"n"});
    }
  }
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
    task_ = static_cast<std::size_t>(context.task_index);
    wakers_.at(task_) = context.waker;
    collector_ = &collector;
  }
  bool next_tuple() override {
    if (!work_.feed.due()) return false;
    const std::uint64_t n = work_.options.sources == 1 ? work_.feed.take() : work_.feed.take_among_others();
    if (work_.options.tracked) {
      collector_->emit(item(n), n);
    } else {
      collector_->emit(item(n));
    }
    return true;
  }
  void ack(MessageId id) override { work_.arrivals[task_].arrived(work_.feed, id, results_of_item(work_.options.dag)); }
  void fail(MessageId) override { ++work_.wrong; }

 private:
  Values item(std::uint64_t n) const {
    switch (work_.options.dag) {
      case Dag::words:
        return is_numbered(work_) ? Values(work_.sentences[n], n) : Values(work_.sentences[n]);
      case Dag::payload:
        return Values(work_.payloads[n], n);
      default:
        return Values(n);
    }
  }
  Workload& work_;
  std::array<topology::SpoutWaker, 2>& wakers_;
  std::size_t task_ = 0;
  SpoutOutputCollector* collector_ = nullptr;
};

/// Hands a tuple on.
class Pass : public BasicBolt {
 public:
  explicit Pass(bool payload) : payload_(payload) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(payload_ ? Fields{"payload", "n"} : Fields{"n"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    collector.emit(payload_ ? Values(tuple.at(0), tuple.at(1)) : Values(tuple.at(0)));
  }

 private:
  const bool payload_;
};

class Sink : public BasicBolt {
 public:
  explicit Sink(Workload& work) : work_(work) {}
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    const bool payload = work_.options.dag == Dag::payload;
    const std::uint64_t n = item_of(tuple, payload ? 1 : 0);
    if (payload && !work_.payloads.is_same(n, tuple.get<Payload>(0))) ++work_.wrong;
    if (!work_.options.tracked) work_.arrivals[0].arrived(work_.feed, n);
  }

 private:
  Workload& work_;
};

class Split : public BasicBolt {
 public:
  explicit Split(bool numbered) : numbered_(numbered) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(numbered_ ? Fields{"word", "n"} : Fields{"word"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    split(tuple.get<std::string_view>(0),
          [&](std::string_view word) { collector.emit(numbered_ ? Values(word, tuple.at(1)) : Values(word)); });
  }

 private:
  const bool numbered_;
};

class Count : public BasicBolt {
 public:
  explicit Count(Workload& work) : work_(work) {}
  void prepare(const Config&, const TopologyContext& context) override { task_ = context.task_index; }
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    ++counts_[tuple.get<std::string>(0)];
    if (work_.options.tracked) return;
    if (is_numbered(work_)) {
      work_.arrivals[task_].arrived(work_.feed, item_of(tuple, 1));
    } else {
      work_.arrivals[task_].arrived();
    }
  }

 private:
  Workload& work_;
  WordCounts counts_;
  int task_ = 0;
};

class IotcloudEngine : public Engine {
 public:
  explicit IotcloudEngine(Workload& work) : sources_(work.options.sources), runtime_(dag(work), options(work)) {
    runtime_.start();
  }
  void pump() override {
    wakers_[0].wake();
    if (sources_ == 2) wakers_[1].wake();
  }
  void stop() override { runtime_.stop(std::chrono::seconds(5)); }

 private:
  topology::Topology dag(Workload& work) {
    topology::TopologyBuilder builder;
    builder.set_spout(
        "source", [&work, this] { return std::make_unique<Source>(work, wakers_); }, work.options.sources);
    const Dag dag = work.options.dag;
    if (dag == Dag::words) {
      const bool numbered = is_numbered(work);
      builder
          .set_bolt(
              "split", [=] { return topology::make_bolt<Split>(numbered); }, 2)
          .shuffle_grouping("source");
      builder
          .set_bolt(
              "count", [&work] { return topology::make_bolt<Count>(work); }, 2)
          .fields_grouping("split", {"word"});
    } else {
      builder
          .set_bolt(
              "pass", [=] { return topology::make_bolt<Pass>(dag == Dag::payload); }, dag == Dag::fan ? 4 : 1)
          .shuffle_grouping("source");
      builder.set_bolt("sink", [&work] { return topology::make_bolt<Sink>(work); }).shuffle_grouping("pass");
    }
    return builder.build(work.options.dag_name);
  }
  topology::RuntimeOptions options(const Workload& work) {
    topology::RuntimeOptions all;
    all.metrics = &metrics_;
    if (work.options.threads > 0) all.threads = work.options.threads;
    if (work.options.tracked) all.max_spout_pending = max_pending;
    all.births = work.options.births;
    return all;
  }
  const int sources_;
  config::Metrics metrics_;
  std::array<topology::SpoutWaker, 2> wakers_;
  topology::Runtime runtime_;
};

}  // namespace

std::unique_ptr<Engine> make_iotcloud_engine(Workload& work) {
  return std::make_unique<IotcloudEngine>(work);
}

}  // namespace iotcloud::bench
