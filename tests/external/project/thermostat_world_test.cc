#include <gtest/gtest.h>

#include <iotcloud/topology/testing/world.h>

using iotcloud::drivers::Direction;
using iotcloud::topology::testing::World;

TEST(ThermostatInAWorld, answers_each_thermometer_with_the_order_for_its_own_reading) {
  World world(
      {.fakes = {{"thermometer",
                  {{.name = "reading", .direction = Direction::out}, {.name = "heater", .direction = Direction::in}}}},
       .plugin_dir = PLUGINS});
  world.run(TOPOLOGY);  // the file of the cluster, and the library thermostat.so
  auto& kitchen = world.add("thermometer");
  auto& cellar = world.add("thermometer");
  kitchen.publish("reading", "23");
  cellar.publish("reading", "17");

  const auto to_kitchen = kitchen.wait_for("heater", 1);
  ASSERT_EQ(to_kitchen.size(), 1u);
  EXPECT_EQ(to_kitchen[0].payload.text(), "23=off");
  EXPECT_EQ(to_kitchen[0].driver_id, kitchen.id());
  const auto to_cellar = cellar.wait_for("heater", 1);
  ASSERT_EQ(to_cellar.size(), 1u);
  EXPECT_EQ(to_cellar[0].payload.text(), "17=on");
}
