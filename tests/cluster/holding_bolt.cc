// A bolt that always holds something: each driver's last tuple waits in it until the next one comes, or until two ticks
// have passed.
#include <map>
#include <string>

#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud::topology;

class HoldingBolt final : public Bolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) {
      for (auto held = held_.begin(); held != held_.end();) {
        if (held->second.ticks++ == 0) {
          ++held;
          continue;
        }
        pass_on(held->second.tuple);
        held = held_.erase(held);
      }
      return;
    }
    Held& held = held_[tuple.get<std::string>("driverID")];
    if (held.tuple) pass_on(held.tuple);
    held = {tuple, 0};
  }
  void cleanup() override { held_.clear(); }

 private:
  struct Held {
    Tuple tuple;
    int ticks = 0;
  };
  void pass_on(const Tuple& tuple) {
    collector_->emit(tuple, Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

  OutputCollector* collector_ = nullptr;
  std::map<std::string, Held> held_;  ///< by driver
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<HoldingBolt>("test.Holding");
}
