#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/tests/topology/workshop.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology::workshop {

/// The first fields of the tuples: "1 2 3".
inline std::string list(std::span<const Tuple> tuples) {
  std::string text;
  for (const Tuple& tuple : tuples) {
    text += (text.empty() ? "" : " ") + std::to_string(tuple.get<std::int64_t>(std::size_t{0}));
  }
  return text;
}

/// Emits the contents of each window. Throws if a window holds the number 13.
struct Show : WindowedBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare({"tuples", "added", "expired", "begin", "end"});
  }
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector& collector) override { out_ = &collector; }
  void execute(const TupleWindow& window) override {
    for (const Tuple& tuple : window.tuples()) {
      if (tuple.get<std::int64_t>(std::size_t{0}) == 13) throw std::runtime_error("unlucky");
    }
    out_->emit(Values(list(window.tuples()), list(window.added()), list(window.expired()), window.begin_ms(),
                      window.end_ms()));
  }
  WindowOutputCollector* out_ = nullptr;
};

/// A source, the windows, and a sink that may fail what it gets.
class Windows {
 public:
  explicit Windows(const WindowOptions& options, const Config& config = {}, int sources = 1) {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(in, {"n", "time"}));
    auto declarer = builder.set_bolt("windows", make_windowed_bolt<Show>(options), 1, config).shuffle_grouping("in");
    if (sources == 2) {
      builder.set_spout("other", source_spout(other, {"n", "time"}));
      declarer.shuffle_grouping("other");
    }
    builder
        .set_bolt("sink", bolt([this](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                    tuples.push_back(tuple.get<std::string>("tuples"));
                    added.push_back(tuple.get<std::string>("added"));
                    expired.push_back(tuple.get<std::string>("expired"));
                    borders.emplace_back(tuple.get<std::int64_t>("begin"), tuple.get<std::int64_t>("end"));
                    if (fail_all) {
                      collector.fail(tuple);
                    } else {
                      collector.ack(tuple);
                    }
                  }))
        .global_grouping("windows");
    if (!options.late_stream.empty()) {
      builder.set_bolt("late", sink_bolt(late)).global_grouping("windows", options.late_stream);
    }
    runtime.emplace(builder.build("t"), bench.options());
    runtime->start();
    runtime->run_until_idle();
  }
  void put(std::int64_t n, std::int64_t time_ms = 0) {
    in->put(Values(n, time_ms));
    runtime->run_until_idle();
  }
  void put_other(std::int64_t n, std::int64_t time_ms) {
    other->put(Values(n, time_ms));
    runtime->run_until_idle();
  }
  void pass(std::chrono::milliseconds time) {
    bench.clock.advance(time);
    runtime->run_due_timers();
    runtime->run_until_idle();
  }
  std::uint64_t counted(const std::string& name) {
    return bench.metrics.counter(name, "", {{"topology", "t"}, {"component", "windows"}, {"task", windows_task()}})
        .value();
  }
  std::string windows_task() const {
    for (const TaskSnapshot& task : runtime->snapshot().tasks) {
      if (task.component == "windows") return std::to_string(task.task_id);
    }
    return "";
  }

  Bench bench;
  std::shared_ptr<Source> in = std::make_shared<Source>();
  std::shared_ptr<Source> other = std::make_shared<Source>();
  std::shared_ptr<Sink> late = std::make_shared<Sink>();
  std::vector<std::string> tuples, added, expired;
  std::vector<std::pair<std::int64_t, std::int64_t>> borders;
  bool fail_all = false;
  std::optional<Runtime> runtime;
};

}  // namespace iotcloud::topology::workshop
