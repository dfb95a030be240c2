// A bolt that counts the messages of each load generator in its state, each message once. If its conf has `out`, it
// writes the counts into a file in that folder, too, whose name is that of the component and the task.
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>
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
  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override {
    if (const auto out = config.find("out"); out != config.end())
      file_ = std::filesystem::path(out->second) / (context.component + "." + std::to_string(context.task));
    collector_ = &collector;
  }
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
    if (!file_.empty()) write(driver);
    collector_->emit(tuple, Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

 private:
  /// \param driver whose message came last
  void write(const std::string& driver) {
    drivers_.insert(driver);
    const std::string partial = file_.string() + ".partial";
    std::ofstream to(partial);
    for (const std::string& each : drivers_) to << each << " " << state_->get_int("count of " + each) << "\n";
    to.close();
    std::filesystem::rename(partial, file_);
  }

  std::filesystem::path file_;
  std::set<std::string> drivers_;  ///< whose messages came since the task began
  OutputCollector* collector_ = nullptr;
  KeyValueState* state_ = nullptr;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt("test.Counting", make_stateful_bolt<CountingBolt>());
}
