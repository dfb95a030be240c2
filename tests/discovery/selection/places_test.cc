#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery {
namespace {

bool chosen_by_place(std::string_view expression, std::map<std::string, std::string> metadata) {
  DriverRecord record;
  record.metadata = std::move(metadata);
  return Selection::parse(expression).matches(record);
}

/// Degrees of a great circle for this many metres.
double degrees(double metres) {
  return metres / 6'371'008.8 * 180 / std::numbers::pi;
}

TEST(SelectionPlaces, MeasureOnTheSphere) {
  // Bloomington, Indiana to Indianapolis: 73.9 km between these points (great circle, mean radius).
  const std::map<std::string, std::string> indianapolis{{"location", "39.7684,-86.1581"}};
  EXPECT_TRUE(chosen_by_place("within(location, 39.1653, -86.5264, 75 km)", indianapolis));
  EXPECT_FALSE(chosen_by_place("within(location, 39.1653, -86.5264, 73 km)", indianapolis));
  EXPECT_FALSE(chosen_by_place("within(location, 39.1653, -86.5264, 73000 m)", indianapolis));
}

TEST(SelectionPlaces, EndSharplyAtTheCircle) {
  for (const double latitude : {0.0, 39.17, -60.0, 85.0}) {
    const std::string circle = "within(location, " + std::to_string(latitude) + ", 10, 500 m)";
    const double east = degrees(1) / std::cos(latitude * std::numbers::pi / 180);
    const auto at = [&](double metres_north, double metres_east) {
      return chosen_by_place(circle, {{"latitude", std::to_string(latitude + degrees(metres_north))},
                                      {"longitude", std::to_string(10 + metres_east * east)}});
    };
    EXPECT_TRUE(at(0, 0));
    EXPECT_TRUE(at(499, 0));
    EXPECT_TRUE(at(-499, 0));
    EXPECT_FALSE(at(501, 0));
    EXPECT_FALSE(at(-501, 0));
    EXPECT_TRUE(at(0, 499));
    EXPECT_FALSE(at(0, 501));
    EXPECT_FALSE(at(360, 360));
  }
}

TEST(SelectionPlaces, KnowNoBorderAtTheDateLineAndAtThePoles) {
  EXPECT_TRUE(chosen_by_place("within(location, 0, 180, 1 km)", {{"location", "0,-179.995"}}));
  EXPECT_FALSE(chosen_by_place("within(location, 0, 180, 1 km)", {{"location", "0,-179.98"}}));
  EXPECT_TRUE(chosen_by_place("within(location, 89.999, 0, 1 km)", {{"location", "89.999,180"}}));
  EXPECT_TRUE(chosen_by_place("within(location, 0, 0, 20100 km)", {{"location", "0,180"}}));
}

TEST(SelectionPlaces, MeasureInThePlane) {
  const std::map<std::string, std::string> robot{{"position", "3, 4"}};
  EXPECT_TRUE(chosen_by_place("within(position, 0, 0, 5 m)", robot));
  EXPECT_FALSE(chosen_by_place("within(position, 0, 0, 4.99 m)", robot));
  EXPECT_TRUE(chosen_by_place("within(position, 1003, 4, 1 km)", robot));
  EXPECT_TRUE(chosen_by_place("within(position, -2, 4, 5 m)", {{"x", "-5"}, {"y", "0"}}));
}

TEST(SelectionPlaces, TakeTheOneKeyBeforeTheTwo) {
  EXPECT_TRUE(chosen_by_place("within(position, 0, 0, 1 m)", {{"position", "0,0"}, {"x", "50"}, {"y", "50"}}));
}

TEST(SelectionPlaces, AreNowhereWhenTheyCannotBeRead) {
  for (const char* text : {"", "1", "1,", ",1", "1;2", "1,2,3", "a,b", "nan,1", "91,0", "0,181", "0x1,2"}) {
    EXPECT_FALSE(chosen_by_place("within(location, 0, 0, 30000 km)", {{"location", text}})) << text;
  }
  EXPECT_FALSE(chosen_by_place("within(location, 0, 0, 30000 km)", {{"latitude", "1"}}));
  EXPECT_FALSE(chosen_by_place("within(position, 0, 0, 30000 km)", {{"y", "1"}}));
  EXPECT_FALSE(chosen_by_place("within(position, 0, 0, 30000 km)", {{"location", "0,0"}}));
}

}  // namespace
}  // namespace iotcloud::discovery
