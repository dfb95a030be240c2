#include <cmath>
#include <cstdint>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <iotcloud/examples/turtlebot_follower/follower.h>

namespace turtlebot_follower {
namespace {

using Frame = std::vector<std::uint16_t>;

Frame empty_frame() {
  return Frame(static_cast<std::size_t>(Follower::width) * Follower::height, 0);
}

void fill(Frame& frame, int u0, int u1, int v0, int v1, std::uint16_t mm) {
  for (int v = v0; v < v1; ++v) {
    for (int u = u0; u < u1; ++u) frame[static_cast<std::size_t>(v) * Follower::width + u] = mm;
  }
}

/// docs/wire.md#follower literally, point by point in doubles, with a box of any size.
Follower::Result reference(const Frame& frame, const Box& box = {}) {
  Follower::Result result;
  double sum_x = 0, sum_z = 0;
  for (int v = 0; v < Follower::height; ++v) {
    for (int u = 0; u < Follower::width; ++u) {
      const double z = frame[static_cast<std::size_t>(v) * Follower::width + u] / 1000.0;
      const double x = (u - 320.0) * z / 600.0;
      const double y = (v - 240.0) * z / 600.0;
      if (!(z > 0 && box.x_min < x && x < box.x_max && box.y_min < y && y < box.y_max && box.z_min < z &&
            z < box.z_max)) {
        continue;
      }
      sum_x += x;
      sum_z += z;
      ++result.points;
    }
  }
  if (result.points <= 4000) return result;
  result.x = sum_x / result.points;
  result.z = sum_z / result.points;
  if (std::abs(result.z - 1.0) < 0.01) return result;
  result.velocity.linear = result.z - 0.7;
  if (std::abs(5 * result.x) >= 0.1) result.velocity.angular = -5 * result.x;
  return result;
}

/// Compares both implementations with the reference.
void expect_same(const Frame& frame, const Box& box = {}) {
  FollowerOptions options;
  options.box = box;
  options.max_linear = options.max_angular = 100;
  const Follower follower(options);
  const auto theirs = reference(frame, box);
  for (const Path path : {Path::portable, Path::avx2}) {
    if (!runs_here(path)) continue;
    SCOPED_TRACE(path == Path::avx2 ? "avx2" : "portable");
    const auto ours = follower.compute(frame, path);
    EXPECT_EQ(ours.points, theirs.points);
    EXPECT_NEAR(ours.x, theirs.x, 1e-9);
    EXPECT_NEAR(ours.z, theirs.z, 1e-9);
    EXPECT_NEAR(ours.velocity.linear, theirs.velocity.linear, 1e-9);
    EXPECT_NEAR(ours.velocity.angular, theirs.velocity.angular, 1e-9);
  }
}

Frame random_frame(std::uint32_t seed, int farthest) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> depth(0, farthest);
  Frame frame = empty_frame();
  for (auto& mm : frame) mm = static_cast<std::uint16_t>(depth(random));
  return frame;
}

TEST(Follower, keeps_exactly_the_points_of_the_reference_for_every_depth_at_every_pixel) {
  // A frame of one depth holds every (u, v) at that depth: the edges of the box, where rounding decides, included.
  for (std::uint16_t mm = 0; mm <= 1001; mm = static_cast<std::uint16_t>(mm + 7)) {
    Frame frame(empty_frame().size(), mm);
    SCOPED_TRACE(mm);
    expect_same(frame);
  }
  for (const std::uint16_t mm : std::initializer_list<std::uint16_t>{400, 500, 600, 750, 960, 999, 1000}) {
    Frame frame(empty_frame().size(), mm);
    SCOPED_TRACE(mm);
    expect_same(frame);
  }
}

TEST(Follower, agrees_with_the_reference_on_random_frames) {
  for (std::uint32_t seed = 1; seed <= 5; ++seed) expect_same(random_frame(seed, 1200));
  expect_same(random_frame(6, 65535));
}

TEST(Follower, agrees_with_the_reference_in_boxes_of_any_size_and_place) {
  const Frame frame = random_frame(7, 12'000);
  expect_same(frame, {.x_min = -10, .x_max = 10, .y_min = -10, .y_max = 10, .z_min = 0, .z_max = 10});
  expect_same(frame, {.x_min = 0.3, .x_max = 1.1, .y_min = -0.7, .y_max = -0.1, .z_min = 0.8, .z_max = 3.2});
  expect_same(frame, {.x_min = -2, .x_max = -0.5, .y_min = -0.2, .y_max = 0.2, .z_min = 1.5, .z_max = 4});
  // The largest possible sums: every pixel at the largest distance.
  expect_same(Frame(frame.size(), 9999),
              {.x_min = -10, .x_max = 10, .y_min = -10, .y_max = 10, .z_min = 0, .z_max = 10});
  // All on one side: the sums of columns do not cancel out.
  Frame right(frame.size(), 0);
  fill(right, 320, 640, 0, 480, 9999);
  expect_same(right, {.x_min = -10, .x_max = 10, .y_min = -10, .y_max = 10, .z_min = 0, .z_max = 10});
}

TEST(Follower, stands_still_before_an_empty_room) {
  const auto result = Follower().compute(Frame(empty_frame().size(), 3000));
  EXPECT_EQ(result.points, 0U);
  EXPECT_EQ(result.velocity.linear, 0);
  EXPECT_EQ(result.velocity.angular, 0);
}

TEST(Follower, needs_more_than_4000_points) {
  Frame frame = empty_frame();
  fill(frame, 300, 340, 350, 450, 800);  // 40 x 100 points
  EXPECT_EQ(Follower().compute(frame).points, 4000U);
  EXPECT_EQ(Follower().compute(frame).velocity.linear, 0);
  frame[static_cast<std::size_t>(350) * Follower::width + 341] = 800;
  EXPECT_NEAR(Follower().compute(frame).velocity.linear, 0.1, 1e-9);
}

TEST(Follower, drives_forward_to_a_person_too_far_away_and_back_from_one_too_near) {
  Frame far = empty_frame();
  fill(far, 280, 360, 330, 470, 900);
  EXPECT_NEAR(Follower().compute(far).velocity.linear, 0.2, 1e-9);
  Frame near = empty_frame();
  fill(near, 280, 360, 360, 470, 600);
  EXPECT_NEAR(Follower().compute(near).velocity.linear, -0.1, 1e-9);
}

TEST(Follower, turns_towards_the_person) {
  Frame right = empty_frame();
  fill(right, 380, 450, 340, 460, 800);
  EXPECT_LT(Follower().compute(right).velocity.angular, -0.1)
      << "a person on the right: a turn to the right is negative";
  Frame left = empty_frame();
  fill(left, 190, 260, 340, 460, 800);
  EXPECT_GT(Follower().compute(left).velocity.angular, 0.1);
}

TEST(Follower, clamps_to_the_limits_it_is_given) {
  Frame frame = empty_frame();
  fill(frame, 400, 460, 330, 470, 900);
  FollowerOptions options;
  options.max_linear = 0.05;
  options.max_angular = 0.2;
  const auto result = Follower(options).compute(frame);
  EXPECT_DOUBLE_EQ(result.velocity.linear, 0.05);
  EXPECT_DOUBLE_EQ(result.velocity.angular, -0.2);
}

TEST(FollowerOptions, have_the_reference_s_constants_unless_conf_says_otherwise) {
  const FollowerOptions options = read_options({});
  EXPECT_EQ(options.goal_distance, 0.7);
  EXPECT_EQ(options.turn_gain, 5);
  EXPECT_EQ(options.min_turn, 0.1);
  EXPECT_EQ(options.stop_distance, 1.0);
  EXPECT_EQ(options.stop_margin, 0.01);
  EXPECT_EQ(options.min_points, 4000U);
  EXPECT_EQ(options.box.x_min, -0.2);
  EXPECT_EQ(options.box.x_max, 0.2);
  EXPECT_EQ(options.box.y_min, 0.1);
  EXPECT_EQ(options.box.y_max, 0.5);
  EXPECT_EQ(options.box.z_min, 0);
  EXPECT_EQ(options.box.z_max, 1.0);
}

TEST(FollowerOptions, are_read_from_conf) {
  const FollowerOptions options = read_options({{"goal_distance", "1.5"},
                                                {"max_linear", "0.3"},
                                                {"max_angular", "1"},
                                                {"turn_gain", "2"},
                                                {"min_turn", "0.2"},
                                                {"stop_distance", "2"},
                                                {"stop_margin", "0.05"},
                                                {"min_points", "100"},
                                                {"x_min", "-0.5"},
                                                {"x_max", "0.4"},
                                                {"y_min", "-0.1"},
                                                {"y_max", "0.3"},
                                                {"z_min", "0.6"},
                                                {"z_max", "2"}});
  Frame frame = empty_frame();
  fill(frame, 380, 440, 220, 260, 1800);  // x from 0.18 to 0.36 m, outside the reference's box
  const auto result = Follower(options).compute(frame);
  EXPECT_EQ(result.points, 2400U);
  EXPECT_DOUBLE_EQ(result.velocity.linear, 0.3);
  EXPECT_NEAR(result.velocity.angular, -2 * 89.5 * 1.8 / 600, 1e-9);
}

std::string refusal(const std::map<std::string, std::string>& conf) {
  try {
    read_options(conf);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "none";
}

TEST(FollowerOptions, refuse_what_is_unknown_or_out_of_range_and_say_what_would_be_right) {
  using testing::HasSubstr;
  EXPECT_EQ(refusal({{"goal_distanze", "1"}}), "conf: goal_distanze: unknown key; did you mean \"goal_distance\"?");
  EXPECT_EQ(refusal({{"max_linear", "-1"}}), "conf: max_linear: \"-1\"; it takes a number from 0 to 10");
  EXPECT_EQ(refusal({{"max_linear", "fast"}}), "conf: max_linear: \"fast\"; it takes a number from 0 to 10");
  EXPECT_EQ(refusal({{"max_linear", "nan"}}), "conf: max_linear: \"nan\"; it takes a number from 0 to 10");
  EXPECT_EQ(refusal({{"z_max", "0.5m"}}), "conf: z_max: \"0.5m\"; it takes a number from 0 to 10");
  EXPECT_THAT(refusal({{"min_points", "0.5"}}), HasSubstr("min_points"));
  EXPECT_EQ(refusal({{"x_min", "0.2"}}),
            "conf: x_min: x_min is 0.2 and x_max is 0.2: nothing is between; make x_min the smaller one");
  EXPECT_THAT(refusal({{"z_min", "1.5"}}), HasSubstr("z_min is 1.5 and z_max is 1"));
  EXPECT_EQ(refusal({{"max_linear", "-1"}, {"turn_gian", "2"}}),
            "conf: max_linear: \"-1\"; it takes a number from 0 to 10\n"
            "conf: turn_gian: unknown key; did you mean \"turn_gain\"?");
}

TEST(Follower, ignores_a_frame_of_another_size) {
  EXPECT_EQ(Follower().compute(Frame(100, 800)).points, 0U);
}

TEST(Follower, writes_the_command_of_the_original) {
  const auto command = nlohmann::json::parse(to_json({0.25, -0.5}));
  EXPECT_EQ(command,
            nlohmann::json::parse(R"({"linear":{"x":0.25,"y":0.0,"z":0.0},"angular":{"x":0.0,"y":0.0,"z":-0.5}})"));
}

}  // namespace
}  // namespace turtlebot_follower
