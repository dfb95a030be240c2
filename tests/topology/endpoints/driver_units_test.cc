// The units of all spouts of a driver, together.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/topology/endpoints/placement/driver_units.h>

namespace iotcloud::topology {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

const DriverUnits::Source source{"t", "d"_driver}, other_driver{"t", "e"_driver}, other_group{"s", "d"_driver};

TEST(DriverUnitsTest, AreThoseOfAllSpoutsOfTheDriverInTheGroup) {
  DriverUnits units;
  EXPECT_THAT(units.of(source), IsEmpty());
  units.set(source, "up", {{"gateway-1"}, {"instance-a", "instance-c"}});
  units.set(source, "side", {{}, {"instance-b", "instance-c"}});
  units.set(other_driver, "up", {{"gateway-2"}, {}});
  units.set(other_group, "up", {{"gateway-3"}, {}});
  EXPECT_THAT(units.of(source),
              ElementsAre(ElementsAre("gateway-1"), ElementsAre("instance-a", "instance-b", "instance-c")));
  units.set(source, "up", {{}, {"instance-a"}});
  EXPECT_THAT(units.of(source), ElementsAre(IsEmpty(), ElementsAre("instance-a", "instance-b", "instance-c")));
}

TEST(DriverUnitsTest, TheOtherSpoutsOfTheDriverAreToldOfEachChange) {
  DriverUnits units;
  int up = 0, side = 0, stranger = 0;
  units.listen(source, "up", [&] { ++up; });
  units.listen(source, "side", [&] { ++side; });
  units.listen(other_driver, "up", [&] { ++stranger; });
  units.set(source, "up", {{"a"}, {}});
  EXPECT_EQ(side, 1);
  EXPECT_EQ(up, 0) << "it knows its own";
  units.set(source, "up", {{"a"}, {}});
  EXPECT_EQ(side, 1) << "nothing changed";
  units.ignore(source, "side");
  units.set(source, "up", {{"a", "b"}, {}});
  EXPECT_EQ(side, 1);
  EXPECT_EQ(stranger, 0);
}

TEST(DriverUnitsTest, AreDescribedByAllSpoutsInOneOrderUnlessThereIsOneOnly) {
  DriverUnits units;
  EXPECT_EQ(units.description(source), "");
  units.declare(source, "up x 4 ");
  units.declare(other_driver, "up x 1 ");
  EXPECT_EQ(units.description(source), "");
  units.declare(source, "side x 1 site == 'lab'");
  EXPECT_EQ(units.description(source), "side x 1 site == 'lab'; up x 4 ");
}

}  // namespace
}  // namespace iotcloud::topology
