#include <charconv>
#include <chrono>
#include <cstdint>
#include <stdexcept>
#include <string>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/state/stateful_bolt.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

using namespace iotcloud::topology;

/// Makes a number of a reading's text.
class Degrees : public MessageBuilder {
 public:
  Values read(const iotcloud::brokers::Message& message, const Fields&) override {
    const std::string_view text = message.payload.text();
    std::int64_t degrees = 0;
    const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), degrees);
    if (status != std::errc{} || end != text.data() + text.size()) throw std::invalid_argument("not a whole number");
    return Values(degrees);
  }
};

/// Orders the heater on below a limit: "17=on".
class Decide : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"order", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override { limit_ = std::stoi(config.at("limit")); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto degrees = tuple.get<std::int64_t>("degrees");
    const std::string order = std::to_string(degrees) + "=" + (degrees < limit_ ? "on" : "off");
    collector.emit(Values(Payload::copy(order), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  int limit_ = 0;
};

/// The mean of all readings in a window.
class Mean : public WindowedBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"mean"}); }
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector& collector) override {
    collector_ = &collector;
  }
  void execute(const TupleWindow& window) override {
    double sum = 0;
    for (const Tuple& tuple : window.tuples()) sum += static_cast<double>(tuple.get<std::int64_t>("degrees"));
    collector_->emit(Values(sum / static_cast<double>(window.tuples().size())));
  }

 private:
  WindowOutputCollector* collector_ = nullptr;
};

/// Counts for each driver how often its heater was switched on. The counts survive the worker.
class Switches : public StatefulBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"driverID", "switches"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& driver = tuple.get<std::string>("driverID");
    const std::string now = tuple.get<Payload>("order").text().ends_with("=on") ? "on" : "off";
    if (now == "on" && state_->get("heater of " + driver) != "on") {
      state_->put_int(driver, state_->get_int(driver) + 1);
      collector_->emit(tuple, Values(driver, state_->get_int(driver)));
    }
    state_->put("heater of " + driver, now);
    collector_->ack(tuple);
  }

 private:
  OutputCollector* collector_ = nullptr;
  KeyValueState* state_ = nullptr;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  using namespace std::chrono_literals;
  registry.add_builder<Degrees>("thermostat.Degrees");
  registry.add_bolt<Decide>("thermostat.Decide");
  registry.add_bolt("thermostat.Mean", make_windowed_bolt<Mean>({.length = 1s}));
  registry.add_bolt("thermostat.Switches", make_stateful_bolt<Switches>({.store = "memory://thermostat"}));
}
