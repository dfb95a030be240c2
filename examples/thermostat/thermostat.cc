// Switches each room's heater: on below one limit, off above another.
#include <map>
#include <string>

#include <iotcloud/topology/plugin.h>

using namespace iotcloud::topology;

class Decide : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"order", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override {
    on_below_ = std::stod(config.at("on_below"));
    off_above_ = std::stod(config.at("off_above"));
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const double degrees = std::stod(tuple.get<std::string>("degrees"));
    bool& heats = heats_[tuple.get<std::string>("driverID")];
    const bool before = heats;
    heats = degrees < on_below_ || (heats && degrees < off_above_);
    if (heats != before)
      collector.emit(Values(std::string(heats ? "on" : "off"), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  double on_below_ = 0, off_above_ = 0;
  std::map<std::string, bool> heats_;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Decide>("thermostat.Decide");
}
