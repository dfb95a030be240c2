// A bolt that counts what a topology of ours gets of the drivers of a Java gateway, and passes it on.
#include <cstdint>
#include <fstream>
#include <set>
#include <string>

#include <nlohmann/json.hpp>

#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud::topology;

/// Message N of an instance has N as its text and as its property `battery`, the time 1700000000000 + N, and `conf:
/// gateway` as its gateway (tests/interop/java, Gateway). Message -1 does not count, nor does one that comes again
/// because the answer to it could not be sent: the broker says so (redelivered). Writes what it saw to `conf: report`
/// when the topology ends.
class TallyBolt final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time", "gatewayID", "battery"});
  }
  void prepare(const Config& config, const TopologyContext&) override {
    report_ = config.at("report");
    gateway_ = config.at("gateway");
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const std::string number(tuple.get<Payload>("data").text());
    if (number != "-1") count(tuple, number);
    collector.emit(
        Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time"), tuple.at("gatewayID"), tuple.at("battery")));
  }
  void cleanup() override {
    std::ofstream(report_) << nlohmann::json{{"received", seen_.size()}, {"twice", twice_}, {"wrong", wrong_}} << '\n';
  }

 private:
  void count(const Tuple& tuple, const std::string& number) {
    const auto& instance = tuple.get<std::string>("driverID");
    const bool is_right = instance.starts_with("instance") && tuple.at("gatewayID") == Value{gateway_} &&
                          tuple.at("time") == Value{1'700'000'000'000 + std::int64_t{std::stoi(number)}} &&
                          tuple.at("battery") == Value{number};
    if (!is_right) ++wrong_;
    if (!seen_.insert(instance + " " + number).second && !tuple.get<bool>("redelivered")) ++twice_;
  }

  std::string report_, gateway_;
  std::set<std::string> seen_;  ///< instance and number of each message
  std::int64_t twice_ = 0, wrong_ = 0;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<TallyBolt>("test.Tally");
}
