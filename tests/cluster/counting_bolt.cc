// A bolt that counts the messages of each load generator in its state, each message once.
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>

#include <iotcloud/tests/topology/state/positions.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace {

using namespace iotcloud::topology;

/// Where a load generator's message has its number (drivers/loadgen/load_generator.h, Head::sequence).
constexpr std::size_t number_offset = 16;

class CountingBolt final : public StatefulBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& driver = tuple.get<std::string>("driverID");
    const std::string_view bytes = tuple.get<Payload>("data").text();
    std::uint64_t number = 0;
    if (bytes.size() < number_offset + sizeof number) throw std::invalid_argument("no message of a load generator");
    std::memcpy(&number, bytes.data() + number_offset, sizeof number);
    auto positions = workshop::Positions::of(state_->get("positions of " + driver));
    if (positions.count(static_cast<std::int64_t>(number))) {
      state_->put("positions of " + driver, positions.text());
      state_->put_int("count of " + driver, state_->get_int("count of " + driver) + 1);
    } else {
      state_->put_int("again of " + driver, state_->get_int("again of " + driver) + 1);
    }
    collector_->emit(tuple, Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

 private:
  OutputCollector* collector_ = nullptr;
  KeyValueState* state_ = nullptr;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt("test.Counting", make_stateful_bolt<CountingBolt>());
}
