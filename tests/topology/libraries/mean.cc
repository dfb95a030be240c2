#include <chrono>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace {
using namespace iotcloud::topology;

/// The mean size of the payloads in a window.
struct MeanSize : WindowedBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"mean"}); }
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector& to) override { collector = &to; }
  void execute(const TupleWindow& window) override {
    double sum = 0;
    for (const Tuple& tuple : window.tuples()) sum += static_cast<double>(tuple.get<Payload>("data").size());
    collector->emit(Values(sum / static_cast<double>(window.tuples().size())));
  }
  WindowOutputCollector* collector = nullptr;
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt("mean.Size", make_windowed_bolt<MeanSize>({.length = std::chrono::seconds(10)}));
}
