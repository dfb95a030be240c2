#include <cmath>
#include <string>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/number.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>
#include <iotcloud/topology/conf_keys.h>

namespace turtlebot_follower {

namespace {

using iotcloud::topology::ConfCheck;

/// One key of `conf`: its value's destination and range.
struct Key {
  std::string name;
  double* value;
  double min, max;
};

void parse(ConfCheck& check, const Key& key, const std::string& text) {
  const auto value = iotcloud::config::parse_number<double>(text);
  if (!value || !(*value >= key.min && *value <= key.max)) {
    check.refuse(key.name, fmt::format("\"{}\"; it takes a number from {} to {}", text, key.min, key.max));
    return;
  }
  *key.value = *value;
}

/// \param conf says which of the two borders the error is about.
void require_inside(ConfCheck& check, const std::map<std::string, std::string>& conf, const std::string& axis,
                    double min, double max) {
  if (min < max) return;
  check.refuse(axis + (conf.contains(axis + "_min") ? "_min" : "_max"),
               fmt::format("{0}_min is {1} and {0}_max is {2}: nothing is between; make {0}_min the smaller one", axis,
                           min, max));
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
  ConfCheck check;
  std::vector<std::string> known;
  for (const Key& key : keys) {
    known.push_back(key.name);
    const auto given = conf.find(key.name);
    if (given != conf.end()) parse(check, key, given->second);
  }
  check.refuse_unknown_keys(conf, "", known);
  if (min_points != std::floor(min_points)) {
    check.refuse("min_points", fmt::format("\"{}\"; it takes a whole number", min_points));
  }
  options.min_points = static_cast<std::uint32_t>(min_points);
  require_inside(check, conf, "x", box.x_min, box.x_max);
  require_inside(check, conf, "y", box.y_min, box.y_max);
  require_inside(check, conf, "z", box.z_min, box.z_max);
  check.finish();
  return options;
}

}  // namespace turtlebot_follower
