#include <chrono>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <variant>

#include <gtest/gtest.h>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/complete_topology.h>

using namespace iotcloud::topology;
using namespace std::chrono_literals;

extern "C" const LibraryDescriptor* iotcloud_topology_library();  // what IOTCLOUD_TOPOLOGY_LIBRARY exports

/// Stands for the spout that reads a broker: the test says what it emits.
class Readings : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"degrees", "driverID", "time"});
  }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }
};

class Thermostat : public ::testing::Test {
 protected:
  Thermostat() {
    iotcloud_topology_library()->fill(components_);
    TopologyBuilder builder;
    builder.set_spout<Readings>("readings");
    builder.set_bolt("decide", *components_.bolt("thermostat.Decide"), 1, {{"limit", "20"}})
        .fields_grouping("readings", {"driverID"});
    builder.set_bolt("mean", *components_.bolt("thermostat.Mean")).fields_grouping("readings", {"driverID"});
    builder.set_bolt("switches", *components_.bolt("thermostat.Switches")).fields_grouping("decide", {"driverID"});
    topology_.emplace(builder.build("test"), SimulatedTopology::Options{.inputs = {"readings"}});
  }
  void read(int degrees) { topology_->put("readings", Values(degrees, "meter-1", std::int64_t{0})); }

  ComponentRegistry components_;
  std::optional<SimulatedTopology> topology_;
};

TEST_F(Thermostat, heats_below_the_limit) {
  read(19);
  read(20);
  const auto orders = topology_->tuples("decide");
  ASSERT_EQ(orders.size(), 2u);
  EXPECT_EQ(std::get<Payload>(orders[0][0]).text(), "19=on");
  EXPECT_EQ(std::get<Payload>(orders[1][0]).text(), "20=off");
}

TEST_F(Thermostat, tells_the_mean_of_each_second) {
  read(10);
  read(20);
  topology_->advance(1s);
  const auto means = topology_->tuples("mean");
  ASSERT_EQ(means.size(), 1u);
  EXPECT_EQ(std::get<double>(means[0][0]), 15);
}

TEST_F(Thermostat, counts_when_a_heater_is_switched_on) {
  for (const int degrees : {19, 18, 21, 19}) read(degrees);
  const auto switches = topology_->tuples("switches");
  ASSERT_EQ(switches.size(), 2u);
  // The state is this process's, and other tests switched heaters, too.
  EXPECT_EQ(std::get<std::int64_t>(switches[1][1]) - std::get<std::int64_t>(switches[0][1]), 1);
}

TEST_F(Thermostat, refuses_a_reading_that_is_no_number) {
  const auto builder = (*components_.builder("thermostat.Degrees"))();
  iotcloud::brokers::Message message;
  message.payload = Payload::copy("17");
  EXPECT_EQ(std::get<std::int64_t>(builder->read(message, {"degrees"})[0]), 17);
  message.payload = Payload::copy("warm");
  EXPECT_THROW(builder->read(message, {"degrees"}), std::invalid_argument);
}
