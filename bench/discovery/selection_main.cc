// Measures how long the selection of drivers by an expression takes, beside the same condition written in C++.
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::bench {
namespace {

using discovery::DriverRecord;

constexpr const char* question = R"(site == "lab" and battery > 20 and within(location, 39.17, -86.52, 500 m))";
constexpr double latitude = 39.17;
constexpr double longitude = -86.52;

/// Makes records of drivers: half of them are in the lab, four fifths have battery, about one in ten is near.
std::vector<DriverRecord> fleet(std::size_t count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> degrees(-0.014, 0.014);
  std::vector<DriverRecord> drivers(count);
  for (std::size_t i = 0; i < count; ++i) {
    DriverRecord& driver = drivers[i];
    driver.name = discovery::DriverName("turtle");
    driver.instance = discovery::new_instance_id();
    driver.gateway = discovery::GatewayId("gateway-" + std::to_string(i % 20));
    driver.state = discovery::DriverState::active;
    driver.metadata = {
        {"battery", std::to_string(random() % 101)},
        {"floor", std::to_string(random() % 5)},
        {"location", std::to_string(latitude + degrees(random)) + "," + std::to_string(longitude + degrees(random))},
        {"model", "turtlebot-2"},
        {"owner", "team-" + std::to_string(random() % 50)},
        {"site", random() % 2 == 0 ? "lab" : "roof"}};
  }
  return drivers;
}

std::optional<double> number_of(const char* first, const char* last) {
  double number = 0;
  const auto [end, status] = std::from_chars(first, last, number);
  if (status != std::errc{} || end != last) return std::nullopt;
  return number;
}

/// The condition as one would write it by hand.
bool plain(const DriverRecord& driver) {
  const auto site = driver.metadata.find("site");
  if (site == driver.metadata.end() || site->second != "lab") return false;
  const auto battery = driver.metadata.find("battery");
  if (battery == driver.metadata.end()) return false;
  const std::string& charge = battery->second;
  const auto percent = number_of(charge.data(), charge.data() + charge.size());
  if (!percent || !(*percent > 20)) return false;
  const auto location = driver.metadata.find("location");
  if (location == driver.metadata.end()) return false;
  const std::string& place = location->second;
  const std::size_t comma = place.find(',');
  if (comma == std::string::npos) return false;
  const auto north = number_of(place.data(), place.data() + comma);
  const auto east = number_of(place.data() + comma + 1, place.data() + place.size());
  if (!north || !east) return false;
  constexpr double radians = std::numbers::pi / 180;
  const double half_north = std::sin((*north - latitude) * radians / 2);
  const double half_east = std::sin((*east - longitude) * radians / 2);
  const double square =
      half_north * half_north + std::cos(*north * radians) * std::cos(latitude * radians) * half_east * half_east;
  return 2 * 6'371'008.8 * std::asin(std::sqrt(square)) <= 500;
}

template <typename Predicate>
double seconds(const std::vector<DriverRecord>& drivers, std::size_t& chosen, const Predicate& predicate) {
  chosen = 0;
  const std::int64_t begin = now_ns();
  for (const DriverRecord& driver : drivers) chosen += predicate(driver) ? 1 : 0;
  return static_cast<double>(now_ns() - begin) * 1e-9;
}

int run(std::size_t count, int rounds) {
  const auto drivers = fleet(count);
  const auto selection = discovery::Selection::parse(question);
  for (int round = -1; round < rounds; ++round) {  // the first one warms up
    std::size_t chosen = 0;
    std::size_t expected = 0;
    const bool ours_first = round % 2 == 0;
    double ours = 0;
    if (ours_first) ours = seconds(drivers, chosen, [&](const auto& driver) { return selection.matches(driver); });
    const double theirs = seconds(drivers, expected, plain);
    if (!ours_first) ours = seconds(drivers, chosen, [&](const auto& driver) { return selection.matches(driver); });
    if (chosen != expected || chosen == 0) {
      std::fprintf(stderr, "the expression chooses %zu drivers, the plain predicate %zu\n", chosen, expected);
      return 1;
    }
    if (round < 0) continue;
    std::printf("{\"figure\":\"choose\",\"drivers\":%zu,\"chosen\":%zu,\"seconds\":%.6f,\"plain_seconds\":%.6f}\n",
                count, chosen, ours, theirs);
  }
  return 0;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  const std::size_t drivers = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 100'000;
  const int rounds = argc > 2 ? std::atoi(argv[2]) : 5;
  if (argc > 3 || drivers == 0 || rounds < 1) {
    std::fprintf(stderr, "usage: %s [DRIVERS] [ROUNDS]\n", argv[0]);
    return 2;
  }
  return iotcloud::bench::run(drivers, rounds);
}
