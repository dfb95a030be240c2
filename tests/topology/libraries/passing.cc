// Passes messages on; for tests of topologies that are sent to pools (tests/system/pool_test.py). With the conf
// `fail_at: prepare` it cannot start.
#include <stdexcept>

#include <iotcloud/topology/plugin.h>

namespace {
using namespace iotcloud::topology;

struct Pass : BasicBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override {
    const auto found = config.find("fail_at");
    if (found != config.end() && found->second == "prepare")
      throw std::runtime_error("as the conf says, this bolt cannot start");
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    collector.emit(Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
  }
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Pass>("passing.Pass");
}
