#include <cmath>
#include <string>
#include <type_traits>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/number.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace turtlebot_follower {

namespace {

using iotcloud::topology::ConfCheck;
using iotcloud::topology::ConfKey;
using Option = iotcloud::topology::ConfOption<FollowerOptions>;

/// What a number may be.
struct Range {
  const char* unit;
  double min, max;
};

/// A key whose value is a number of that range. \param of a member of the options, which has the default
template <typename Of>
Option number(const char* name, const Range& range, Of of, const char* text) {
  FollowerOptions usual;
  return {ConfKey{name, fmt::format("{}, {:g} to {:g}", range.unit, range.min, range.max),
                  fmt::format("`{:g}`", static_cast<double>(of(usual))), text},
          [range, of](ConfCheck& check, const std::string& key, const std::string& given, FollowerOptions& options) {
            using Number = std::remove_reference_t<decltype(of(options))>;
            const auto value = iotcloud::config::parse_number<double>(given);
            if (!value || !(*value >= range.min && *value <= range.max)) {
              check.refuse(key, fmt::format("\"{}\"; it takes a number from {} to {}", given, range.min, range.max));
            } else if (std::is_integral_v<Number> && *value != std::floor(*value)) {
              check.refuse(key, fmt::format("\"{}\"; it takes a whole number", given));
            } else {
              of(options) = static_cast<Number>(*value);
            }
          }};
}

const std::vector<Option>& declared() {
  using Options = FollowerOptions;
  constexpr Range distance{"m", 0, farthest_box}, speed{"m/s", 0, 10}, turn{"rad/s", 0, 100},
      gain{"rad/s for each m", 0, 100}, points{"points", 0, Follower::width * Follower::height},
      across{"m", -farthest_box, farthest_box};
  static const std::vector<Option> all{
      number(
          "goal_distance", distance, [](Options& o) -> double& { return o.goal_distance; },
          "distance that it keeps between camera and person"),
      number(
          "max_linear", speed, [](Options& o) -> double& { return o.max_linear; }, "limit of its commands"),
      number(
          "max_angular", turn, [](Options& o) -> double& { return o.max_angular; }, "limit of its commands"),
      number(
          "turn_gain", gain, [](Options& o) -> double& { return o.turn_gain; },
          "how hard it turns towards a person beside the optical axis"),
      number(
          "min_turn", turn, [](Options& o) -> double& { return o.min_turn; },
          "it does not turn if the turn would be slower than this"),
      number(
          "stop_distance", distance, [](Options& o) -> double& { return o.stop_distance; },
          "it stands still while the person is this far away: the person is leaving the box"),
      number(
          "stop_margin", distance, [](Options& o) -> double& { return o.stop_margin; },
          "largest difference from `stop_distance` at which it does"),
      number(
          "min_points", points, [](Options& o) -> std::uint32_t& { return o.min_points; },
          "with this many points in the box, or fewer, there is nobody to follow"),
      number(
          "x_min", across, [](Options& o) -> double& { return o.box.x_min; },
          "the box: its left border, to the right of the camera"),
      number(
          "x_max", across, [](Options& o) -> double& { return o.box.x_max; }, "its right border"),
      number(
          "y_min", across, [](Options& o) -> double& { return o.box.y_min; }, "its upper border, below the camera"),
      number(
          "y_max", across, [](Options& o) -> double& { return o.box.y_max; }, "its lower border"),
      number(
          "z_min", distance, [](Options& o) -> double& { return o.box.z_min; },
          "its near border, in front of the camera"),
      number(
          "z_max", distance, [](Options& o) -> double& { return o.box.z_max; }, "its far border")};
  return all;
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

std::vector<ConfKey> follower_conf_keys() {
  return iotcloud::topology::keys_of(declared());
}

FollowerOptions read_options(const std::map<std::string, std::string>& conf) {
  FollowerOptions options;
  const Box& box = options.box;
  ConfCheck check;
  check.read(conf, "", declared(), options);
  require_inside(check, conf, "x", box.x_min, box.x_max);
  require_inside(check, conf, "y", box.y_min, box.y_max);
  require_inside(check, conf, "z", box.z_min, box.z_max);
  check.finish();
  return options;
}

}  // namespace turtlebot_follower
