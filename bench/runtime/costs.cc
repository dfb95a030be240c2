// Measures the runtime's costs that are not compared with other engines: the heap, copies, an idle topology, ten
// thousand tasks. Prints one line of JSON for each figure.
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>

#include <iotcloud/bench/harness/allocations.h>
#include <iotcloud/bench/runtime/iotcloud_engine.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::bench {

namespace {

using topology::BasicBolt;
using topology::BasicOutputCollector;
using topology::Tuple;
using topology::Values;

void print(const std::string& figure, double value) {
  std::printf("{\"figure\":\"%s\",\"value\":%.15g}\n", figure.c_str(), value);
  std::fflush(stdout);
}

void pause(double seconds) {
  sleep_until(now_ns() + static_cast<std::int64_t>(seconds * 1e9));
}

/// Runs a DAG and prints the heap's operations per result in the steady state.
/// \param rate 0: on the pool, as fast as possible; otherwise on the thread that wakes the source. \return false:
/// tuples were lost.
bool heap(const char* dag_name, Dag dag, bool tracked, double rate, double seconds) {
  Options options;
  options.dag = dag;
  options.dag_name = dag_name;
  options.tracked = tracked;
  options.rate = rate;
  Workload work(options);
  work.feed.start();
  const std::unique_ptr<Engine> engine = make_iotcloud_engine(work);
  const auto arrived = [&] { return work.arrivals[0].count() + work.arrivals[1].count(); };
  std::thread source([&] {
    engine->pump();
    for (std::uint64_t n = 1; rate > 0 && !work.feed.stopped(); ++n) {
      sleep_until(work.feed.intended_ns(n));
      engine->pump();
    }
  });
  pause(2 * seconds);
  const std::uint64_t allocated = allocations(), first = arrived();
  pause(seconds);
  const double results = static_cast<double>(arrived() - first);
  const double per_result = static_cast<double>(allocations() - allocated) / results;
  work.feed.stop();
  source.join();
  while (arrived() < work.feed.sent() * results_of_item(dag) && work.wrong == 0) std::this_thread::yield();
  engine->stop();
  const std::string how = std::string(tracked ? "tracked" : "untracked") + (rate > 0 ? ", 10 000/s" : "");
  print("heap: " + std::string(dag_name) + ", " + how, per_result);
  if (dag == Dag::payload) print("copies: " + how, static_cast<double>(work.wrong.load()));
  return arrived() == work.feed.sent() * results_of_item(dag);
}

/// Runs a chain that waits, which shows whether a thread spins.
void idle(double seconds) {
  Options options;
  options.rate = 1e-3;  // the first item is due at once, the next one much later
  Workload work(options);
  work.feed.start();
  const std::unique_ptr<Engine> engine = make_iotcloud_engine(work);
  pause(0.5);
  engine->pump();
  pause(0.1);
  const Usage before = Usage::now();
  pause(seconds);
  const Usage after = Usage::now();
  engine->stop();
  print("idle: cpu", after.cpu_percent_since(before));
  print("idle: switches", after.switches_per_second_since(before));
}

class Quiet : public topology::Spout {
 public:
  explicit Quiet(std::uint64_t& left) : left_(left) {}
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override { declarer.declare({"key"}); }
  void open(const topology::Config&, const topology::TopologyContext& context,
            topology::SpoutOutputCollector& collector) override {
    waker = context.waker;
    collector_ = &collector;
  }
  bool next_tuple() override {
    if (left_ == 0) return false;
    collector_->emit(Values(--left_));
    return true;
  }
  topology::SpoutWaker waker;

 private:
  std::uint64_t& left_;
  topology::SpoutOutputCollector* collector_ = nullptr;
};

class Relay : public BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override { declarer.declare({"key"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override { collector.emit(Values(tuple.at(0))); }
};

class End : public BasicBolt {
 public:
  void execute(const Tuple&, BasicOutputCollector&) override {}
};

/// One spout and two components of bolts, the second grouped by key, 10 000 tasks in all.
void ten_thousand_tasks() {
  std::uint64_t left = 0;
  topology::SpoutWaker waker;
  topology::TopologyBuilder builder;
  Quiet* spout = nullptr;
  builder.set_spout("source", [&] {
    auto made = std::make_unique<Quiet>(left);
    spout = made.get();
    return made;
  });
  builder.set_bolt<Relay>("relay", 5000).shuffle_grouping("source");
  builder.set_bolt<End>("end", 4999).fields_grouping("relay", {"key"});
  config::Metrics metrics;
  topology::RuntimeOptions options;
  options.metrics = &metrics;
  const auto megabytes = [](std::size_t before) {
    return (static_cast<double>(resident_bytes()) - static_cast<double>(before)) / 1e6;
  };
  const std::size_t before = resident_bytes();
  topology::Runtime runtime(builder.build("many"), options);
  runtime.start();
  while (!runtime.idle()) std::this_thread::yield();
  print("10 000 tasks: idle MB", megabytes(before));
  const Usage usage = Usage::now();
  pause(1);
  print("10 000 tasks: idle cpu", Usage::now().cpu_percent_since(usage));
  left = 100'000;
  spout->waker.wake();
  while (!runtime.idle()) std::this_thread::yield();
  print("10 000 tasks: worked MB", megabytes(before));
  runtime.stop(std::chrono::seconds(10));
}

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  using namespace iotcloud::bench;
  const double seconds = argc > 1 ? std::strtod(argv[1], nullptr) : 0;
  if (argc != 2 || seconds <= 0) {
    std::fprintf(stderr, "usage: %s SECONDS_OF_EACH_MEASUREMENT\n", argv[0]);
    return 2;
  }
  ten_thousand_tasks();  // first, because it would reuse memory that the others leave in the heap
  idle(5 * seconds);
  bool complete = true;
  for (const bool tracked : {false, true}) {
    complete &= heap("chain", Dag::chain, tracked, 0, seconds);
    complete &= heap("chain", Dag::chain, tracked, 10'000, seconds);
    complete &= heap("fan", Dag::fan, tracked, 0, seconds);
    complete &= heap("payload", Dag::payload, tracked, 0, seconds);
    complete &= heap("words", Dag::words, tracked, 0, seconds);
  }
  if (!complete) std::fprintf(stderr, "not every result arrived\n");
  return complete ? 0 : 1;
}
