// A map of the vehicles that the topology's file selects, a line for each, every second.
#include <map>
#include <string>

#include <iotcloud/topology/plugin.h>

using namespace iotcloud::topology;

class Map : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"vehicles", "map"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    if (!tuple.is_tick()) {
      places_[tuple.get<std::string>("driverID")] = tuple.get<std::string>("place");
      return;
    }
    std::string map;
    for (const auto& [vehicle, place] : places_)
      map += (map.empty() ? "" : "; ") + vehicle.substr(0, 6) + " at " + place;
    collector.emit(Values(static_cast<std::int64_t>(places_.size()), map));
    places_.clear();  // who has sent nothing for a second, or has left the circle, is not on the next map
  }

 private:
  std::map<std::string, std::string> places_;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Map>("fleet_map.Map");
}
