// Passes messages on; for tests of topologies that are sent to pools (tests/system/pool_test.py). With the conf
// `fail_at: prepare` it cannot start; with `stand_still: FILE` a call that finds the file removes it and does not
// return.
#include <cstdio>
#include <stdexcept>
#include <string>

#include <unistd.h>

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
    const auto file = config.find("stand_still");
    if (file != config.end()) stand_still_ = file->second;
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    if (!stand_still_.empty() && std::remove(stand_still_.c_str()) == 0) {
      while (true) pause();
    }
    collector.emit(Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  std::string stand_still_;
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Pass>("passing.Pass");
}
