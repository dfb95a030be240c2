#include <string>

#include <iotcloud/topology/plugin.h>

using namespace iotcloud::topology;

/// Orders the heater on below a limit: "17=on".
class Decide : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"order", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override { limit_ = std::stoi(config.at("limit")); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const std::string reading(tuple.get<Payload>("reading").text());
    const std::string order = reading + "=" + (std::stoi(reading) < limit_ ? "on" : "off");
    collector.emit(Values(Payload::copy(order), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  int limit_ = 0;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Decide>("thermostat.Decide");
}
