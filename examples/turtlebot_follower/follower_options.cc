#include <algorithm>
#include <charconv>
#include <cmath>
#include <iterator>
#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace turtlebot_follower {

namespace {

/// One key of `conf`: its value's destination and range.
struct Key {
  std::string name;
  double* value;
  double min, max;
};

double parse(const Key& key, const std::string& text) {
  double value = 0;
  const char* end = text.data() + text.size();
  const auto [stop, status] = std::from_chars(text.data(), end, value);
  if (status != std::errc{} || stop != end || !(value >= key.min && value <= key.max)) {
    throw std::invalid_argument(
        fmt::format("{}: \"{}\"; it takes a number from {} to {}", key.name, text, key.min, key.max));
  }
  return value;
}

void require_inside(const char* axis, double min, double max) {
  if (min < max) return;
  throw std::invalid_argument(fmt::format(
      "{0}_min is {1} and {0}_max is {2}: nothing is between; make {0}_min the smaller one", axis, min, max));
}

}  // namespace

FollowerOptions read_options(const std::map<std::string, std::string>& conf) {
  FollowerOptions options;
  double min_points = options.min_points;
  Box& box = options.box;
  const Key keys[] = {{"goal_distance", &options.goal_distance, 0, farthest_box},
                      {"max_linear", &options.max_linear, 0, 10},
                      {"max_angular", &options.max_angular, 0, 100},
                      {"turn_gain", &options.turn_gain, 0, 100},
                      {"min_turn", &options.min_turn, 0, 100},
                      {"stop_distance", &options.stop_distance, 0, farthest_box},
                      {"stop_margin", &options.stop_margin, 0, farthest_box},
                      {"min_points", &min_points, 0, Follower::width * Follower::height},
                      {"x_min", &box.x_min, -farthest_box, farthest_box},
                      {"x_max", &box.x_max, -farthest_box, farthest_box},
                      {"y_min", &box.y_min, -farthest_box, farthest_box},
                      {"y_max", &box.y_max, -farthest_box, farthest_box},
                      {"z_min", &box.z_min, 0, farthest_box},
                      {"z_max", &box.z_max, 0, farthest_box}};
  std::string known;
  for (const Key& key : keys) {
    known += (known.empty() ? "" : ", ") + key.name;
    const auto given = conf.find(key.name);
    if (given != conf.end()) *key.value = parse(key, given->second);
  }
  for (const auto& [name, value] : conf) {
    const auto is_it = [&name = name](const Key& key) { return key.name == name; };
    if (std::none_of(std::begin(keys), std::end(keys), is_it)) {
      throw std::invalid_argument(fmt::format("unknown key \"{}\" in conf; the follower knows: {}", name, known));
    }
  }
  if (min_points != std::floor(min_points)) {
    throw std::invalid_argument(fmt::format("min_points: \"{}\"; it takes a whole number", min_points));
  }
  options.min_points = static_cast<std::uint32_t>(min_points);
  require_inside("x", box.x_min, box.x_max);
  require_inside("y", box.y_min, box.y_max);
  require_inside("z", box.z_min, box.z_max);
  return options;
}

}  // namespace turtlebot_follower
