#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <gtest/gtest.h>
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

/// REFERENCE.md section 6 as it is written there, point by point in doubles.
Follower::Result reference(const Frame& frame) {
  Follower::Result result;
  double sum_x = 0, sum_z = 0;
  for (int v = 0; v < Follower::height; ++v) {
    for (int u = 0; u < Follower::width; ++u) {
      const double z = frame[static_cast<std::size_t>(v) * Follower::width + u] / 1000.0;
      const double x = (u - 320.0) * z / 600.0;
      const double y = (v - 240.0) * z / 600.0;
      if (!(z > 0 && -0.2 < x && x < 0.2 && 0.1 < y && y < 0.5 && z < 1.0)) continue;
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

void expect_same(const Frame& frame) {
  const auto ours = Follower().compute(frame);
  const auto theirs = reference(frame);
  EXPECT_EQ(ours.points, theirs.points);
  EXPECT_NEAR(ours.velocity.linear, theirs.velocity.linear, 1e-9);
  EXPECT_NEAR(ours.velocity.angular, theirs.velocity.angular, 1e-9);
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
  std::mt19937 random(1);
  std::uniform_int_distribution<int> depth(0, 1200);
  for (int i = 0; i < 5; ++i) {
    Frame frame = empty_frame();
    for (auto& mm : frame) mm = static_cast<std::uint16_t>(depth(random));
    expect_same(frame);
  }
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
