#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/turtle/simulator/world.h>
#include <iotcloud/tests/drivers/turtle/reference_follower.h>

namespace iotcloud::drivers::turtle::simulator {
namespace {

using Frame = std::vector<std::uint16_t>;

constexpr int width = 640;

Frame render(Kinect& kinect, const Room& room, const std::vector<Prism>& body, const Pose& camera = {}) {
  Frame frame(depth::frame_pixels);
  kinect.render(room, body, camera, depth::FrameSpan(frame));
  return frame;
}

Room hall() {
  return {50, 50, {}};
}

std::uint16_t at(const Frame& frame, int column, int row) {
  return frame[static_cast<std::size_t>(row * width + column)];
}

bool reads(std::uint16_t disparity) {
  return disparity != depth::no_reading;
}

/// Readings in metres of a rectangle of pixels.
std::vector<double> readings(const Frame& frame, int left, int top, int right, int bottom) {
  std::vector<double> metres;
  for (int row = top; row < bottom; ++row) {
    for (int column = left; column < right; ++column) {
      if (reads(at(frame, column, row))) metres.push_back(depth::disparity_to_mm(at(frame, column, row)) / 1000.0);
    }
  }
  return metres;
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

double deviation(const std::vector<double>& values) {
  const double middle = mean(values);
  double sum = 0;
  for (const double value : values) sum += (value - middle) * (value - middle);
  return std::sqrt(sum / static_cast<double>(values.size()));
}

/// A wide upright panel whose face is `distance` metres ahead of a camera at the origin that looks along x.
std::vector<Prism> panel(double distance) {
  return {box({distance + 0.05, 0, 0}, 0.1, 20, 0, 5)};
}

TEST(Kinect, reads_true_distances) {
  Kinect kinect(1);
  for (const double distance : {0.6, 1.0, 1.5, 2.0, 3.0, 3.8}) {
    const auto metres = readings(render(kinect, hall(), panel(distance)), 200, 100, 440, 300);
    // The table truncates: half a step of disparity and a millimetre.
    EXPECT_NEAR(mean(metres), distance, 0.002 + 0.002 * distance) << distance;
  }
}

TEST(Kinect, sees_the_floor_and_bodies_where_a_pinhole_camera_does) {
  Kinect kinect(1);
  const Frame floor = render(kinect, hall(), {});
  for (const int row : {350, 400, 450, 479}) {
    const double expected = Kinect::height * 600 / (row - 240);
    EXPECT_NEAR(mean(readings(floor, 100, row, 600, row + 1)), expected, 0.01 * expected) << row;
  }
  EXPECT_TRUE(readings(floor, 0, 0, width, 240).empty());  // nothing above the horizon

  // A pole of 10 cm, 2 m ahead and 0.5 m to the left, 0.2 m to 0.7 m high.
  const Frame pole = render(kinect, hall(), {cylinder(2.05, 0.5, 0.05, 0.2, 0.7)});
  const int column = 320 - static_cast<int>(std::lround(600 * 0.5 / 2.05));
  EXPECT_NEAR(mean(readings(pole, column - 5, 200, column + 6, 280)), 2.0, 0.02);
  EXPECT_TRUE(readings(pole, column - 20, 200, column - 17, 239).empty());
  EXPECT_TRUE(readings(pole, column + 18, 200, column + 21, 239).empty());
  constexpr int half_height = 75;                                                            // 600 * 0.25 / 2.0
  EXPECT_TRUE(readings(pole, column - 5, 100, column + 6, 240 - half_height - 3).empty());   // over its top
  EXPECT_GT(mean(readings(pole, column - 5, 240 + half_height + 3, column + 6, 330)), 2.3);  // under it
}

TEST(Kinect, sees_tops_from_above_and_undersides_from_below) {
  Kinect kinect(1);
  // A stool's seat at 0.25 m, and a shelf board at 0.65 m, both 1.5 m to 2 m ahead.
  const Frame stool = render(kinect, hall(), {box({1.75, 0, 0}, 0.5, 0.5, 0.20, 0.25)});
  const int top_row = 240 + static_cast<int>(600 * 0.20 / 1.75);
  EXPECT_NEAR(mean(readings(stool, 300, top_row, 340, top_row + 1)), 1.75, 0.03);
  const Frame board = render(kinect, hall(), {box({1.75, 0, 0}, 0.5, 0.5, 0.65, 0.70)});
  const int under_row = 240 - static_cast<int>(600 * 0.20 / 1.75);
  EXPECT_NEAR(mean(readings(board, 300, under_row, 340, under_row + 1)), 1.75, 0.03);
}

TEST(Kinect, has_noise_that_grows_with_the_square_of_the_distance) {
  Kinect kinect(1);
  const auto noise = [&](double distance) {
    std::vector<double> metres;
    for (int i = 0; i < 3; ++i) {
      const auto more = readings(render(kinect, hall(), panel(distance)), 100, 50, 540, 300);
      metres.insert(metres.end(), more.begin(), more.end());
    }
    return deviation(metres);
  };
  const double at_1 = noise(1.0), at_2 = noise(2.0), at_3 = noise(3.0);
  EXPECT_GT(at_1, 0.001);
  EXPECT_LT(at_1, 0.004);
  EXPECT_NEAR(at_2 / at_1, 4, 1);
  EXPECT_NEAR(at_3 / at_1, 9, 2);
}

TEST(Kinect, quantises_by_disparity_so_that_steps_grow_with_distance) {
  Kinect kinect(1);
  const auto distinct = [&](double distance) {
    std::map<double, int> counts;
    for (const double metres : readings(render(kinect, hall(), panel(distance)), 100, 50, 540, 300)) ++counts[metres];
    return counts;
  };
  // Noise of half a disparity reaches a few values; between them lies z^2 / 351 m.
  for (const double distance : {1.0, 3.5}) {
    const auto counts = distinct(distance);
    EXPECT_GE(counts.size(), 2);
    EXPECT_LE(counts.size(), 8);
    const double step = std::next(counts.begin())->first - counts.begin()->first;
    EXPECT_NEAR(step, distance * distance / 351, 0.15 * distance * distance / 351 + 0.001) << distance;
  }
}

TEST(Kinect, reads_nothing_nearer_than_half_a_metre_or_beyond_four) {
  Kinect kinect(1);
  for (const double distance : {0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.48}) {
    EXPECT_TRUE(readings(render(kinect, hall(), panel(distance)), 0, 0, width, 480).empty()) << distance;
  }
  EXPECT_GT(readings(render(kinect, hall(), panel(0.52)), 200, 100, 440, 300).size(), 40'000);
  EXPECT_GT(readings(render(kinect, hall(), panel(3.8)), 200, 100, 440, 230).size(), 30'000);
  EXPECT_TRUE(readings(render(kinect, hall(), panel(4.3)), 0, 0, width, 240).empty());
  const Room room = living_room();
  for (const double heading : {0.0, 1.0, 2.5, 4.0}) {
    const Frame frame = render(kinect, room, {}, {0.8, -1.2, heading});
    for (const std::uint16_t disparity : frame) {
      if (!reads(disparity)) continue;
      ASSERT_GE(depth::disparity_to_mm(disparity), 500);
      ASSERT_LE(depth::disparity_to_mm(disparity), 4000);
    }
  }
}

TEST(Kinect, has_a_shadow_at_the_left_of_what_is_near) {
  Kinect kinect(1);
  auto scene = panel(3.0);
  scene.push_back(box({1.05, 0, 0}, 0.1, 0.3, 0, 5));  // 1 m ahead, 90 pixels to each side
  const Frame frame = render(kinect, hall(), scene);
  // Seen from the projector, 7.5 cm to the right, it hides 600 * 0.075 * (1/1 - 1/3) = 30 columns of the panel.
  EXPECT_TRUE(readings(frame, 320 - 90 - 28, 100, 320 - 90 - 2, 300).empty());
  EXPECT_GT(readings(frame, 320 - 90 - 60, 100, 320 - 90 - 34, 300).size(), 26 * 200 * 0.95);
  EXPECT_GT(readings(frame, 320 + 90 + 4, 100, 320 + 90 + 30, 300).size(), 26 * 200 * 0.95);
}

TEST(Kinect, cannot_read_glass_nor_all_of_what_is_dark) {
  Kinect kinect(1);
  const auto share = [&](Surface surface) {
    const Frame frame = render(kinect, hall(), {box({1.55, 0, 0}, 0.1, 20, 0, 5, surface)});
    return static_cast<double>(readings(frame, 100, 50, 540, 350).size()) / (440 * 300);
  };
  EXPECT_GT(share(Surface::plain), 0.98);
  EXPECT_LT(share(Surface::plain), 1.0);  // specks
  EXPECT_GT(share(Surface::dark), 0.4);
  EXPECT_LT(share(Surface::dark), 0.9);
  EXPECT_EQ(share(Surface::glass), 0);
  // Glass behind another object does not matter.
  auto scene = panel(1.0);
  scene.push_back(box({1.55, 0, 0}, 0.1, 20, 0, 5, Surface::glass));
  EXPECT_GT(readings(render(kinect, hall(), scene), 100, 50, 540, 350).size(), 0.98 * 440 * 300);
}

TEST(Kinect, gives_the_same_frames_for_the_same_seed_and_new_noise_in_each_frame) {
  const Room room = living_room();
  Kinect one(7), same(7), other(8);
  const Pose camera{0.5, -1.5, 0.3};
  const Frame first = render(one, room, {}, camera);
  EXPECT_EQ(first, render(same, room, {}, camera));
  EXPECT_NE(first, render(other, room, {}, camera));
  EXPECT_NE(first, render(one, room, {}, camera));
}

TEST(Room, keeps_the_floor_out_of_the_follower_s_box) {
  Kinect kinect(1);
  const Frame disparities = render(kinect, hall(), {});
  depth::DepthEncoder encoder;
  depth::DepthDecoder decoder;
  Frame mm(depth::frame_pixels);
  ASSERT_EQ(decoder.decode(encoder.encode(depth::FrameView(disparities)), depth::FrameSpan(mm)),
            depth::DecodeError::none);
  EXPECT_EQ(follow(depth::FrameView(mm)).points, 0);
}

TEST(Walker, stays_clear_of_the_furniture_and_within_its_speed_for_every_seed) {
  const Room room = living_room();
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Walker person(seed);
    Pose before = person.pose();
    double walked = 0;
    for (int step = 0; step < 4000; ++step) {  // 80 s, most of a round
      person.advance(0.02);
      const Pose now = person.pose();
      const double way = std::hypot(now.x - before.x, now.y - before.y);
      ASSERT_LE(way, (Walker::top_speed + 0.002) * 0.02) << "seed " << seed;
      walked += way;
      before = now;
      ASSERT_LT(std::abs(now.x), room.half_length - 0.8) << "seed " << seed;
      ASSERT_LT(std::abs(now.y), room.half_width - 0.8) << "seed " << seed;
      for (const Prism& prism : room.furniture) ASSERT_GT(distance_to(prism, now.x, now.y), 0.4) << "seed " << seed;
    }
    EXPECT_GT(walked, 7) << "seed " << seed;
    EXPECT_LT(walked, 16) << "seed " << seed;
  }
}

TEST(Walker, turns_both_ways) {
  int left = 0, right = 0;
  Walker person(4);
  double heading = person.pose().heading;
  for (int step = 0; step < 5000; ++step) {
    person.advance(0.02);
    const double turn = std::remainder(person.pose().heading - heading, 2 * M_PI);
    heading = person.pose().heading;
    if (turn > 1e-4) ++left;
    if (turn < -1e-4) ++right;
  }
  EXPECT_GT(std::min(left, right), 100);
}

TEST(Base, keeps_its_limits_of_speed_and_acceleration) {
  const Room room = hall();
  Base base({});
  base.command({5, -20});
  Velocity before = base.velocity();
  for (int step = 0; step < 110; ++step) {  // 0.55 s: its own time-out is later
    base.advance(0.005, room, {10, 10, 0});
    EXPECT_LE(base.velocity().linear - before.linear, Base::linear_acceleration * 0.005 + 1e-9);
    EXPECT_LE(before.angular - base.velocity().angular, Base::angular_acceleration * 0.005 + 1e-9);
    EXPECT_LE(base.velocity().linear, Base::top_linear);
    EXPECT_GE(base.velocity().angular, -Base::top_angular);
    before = base.velocity();
  }
  EXPECT_DOUBLE_EQ(base.velocity().angular, -Base::top_angular);
  EXPECT_NEAR(base.velocity().linear, 0.44, 0.001);
}

TEST(Base, stops_by_itself_when_no_command_comes) {
  const Room room = hall();
  Base base({});
  base.command({0.2, 0});
  for (int step = 0; step < 118; ++step) base.advance(0.005, room, {10, 10, 0});
  EXPECT_DOUBLE_EQ(base.velocity().linear, 0.2);  // at 0.59 s
  for (int step = 0; step < 60; ++step) base.advance(0.005, room, {10, 10, 0});
  EXPECT_DOUBLE_EQ(base.velocity().linear, 0);  // at 0.89 s
}

TEST(Base, drives_an_arc) {
  const Room room = hall();
  Base base({});
  for (int step = 0; step < 2000; ++step) {
    base.command({0.2, 0.4});
    base.advance(0.005, room, {10, 10, 0});
  }
  // Once under way it goes round a circle of 0.5 m: where it is and where it looks belong together.
  const double center_x = base.pose().x - 0.5 * std::sin(base.pose().heading);
  const double center_y = base.pose().y + 0.5 * std::cos(base.pose().heading);
  EXPECT_NEAR(center_x, 0, 0.05);
  EXPECT_NEAR(center_y, 0.5, 0.05);
}

TEST(Base, does_not_enter_walls_furniture_or_the_person_and_gets_away_from_them) {
  Room room = hall();
  room.furniture.push_back(box({1.5, 0, 0}, 0.4, 2, 0, 1));
  const auto drive = [](Base& base, const Room& where, const Pose& person, double speed, int steps) {
    for (int step = 0; step < steps; ++step) {
      base.command({speed, 0});
      base.advance(0.005, where, person);
    }
  };
  Base base({});
  drive(base, room, {10, 10, 0}, 0.5, 2000);
  EXPECT_NEAR(base.pose().x, 1.3 - Base::radius, 0.01);
  drive(base, room, {10, 10, 0}, -0.5, 400);
  EXPECT_LT(base.pose().x, 0.6);
  Base to_person({});
  drive(to_person, hall(), {2, 0, 0}, 0.5, 2000);
  EXPECT_NEAR(to_person.pose().x, 2 - 0.15 - Base::radius, 0.01);
  Base to_wall({});
  drive(to_wall, {2, 2, {}}, {10, 10, 0}, 0.5, 2000);
  EXPECT_NEAR(to_wall.pose().x, 2 - Base::radius, 0.01);
}

/// A lock-step loop of world, codec and reference follower, without driver and host.
struct Loop {
  explicit Loop(std::uint64_t seed) : world(seed), disparities(depth::frame_pixels), mm(depth::frame_pixels) {}
  /// Runs one frame; the follower's command takes effect `delay` seconds later.
  Followed step(double delay = 0) {
    world.render(depth::FrameSpan(disparities));
    EXPECT_EQ(decoder.decode(encoder.encode(depth::FrameView(disparities)), depth::FrameSpan(mm)),
              depth::DecodeError::none);
    const Followed followed = follow(depth::FrameView(mm));
    truth = world.truth();
    world.advance_to(frame / 30.0 + delay);
    world.command(followed.command);
    world.advance_to(++frame / 30.0);
    return followed;
  }
  World world;
  GroundTruth truth;  ///< at the time of the last frame
  int frame = 0;
  Frame disparities, mm;
  depth::DepthEncoder encoder;
  depth::DepthDecoder decoder;
};

TEST(World, starts_with_the_person_before_the_robot_and_waits_for_a_command) {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    World world(seed);
    const GroundTruth start = world.truth();
    EXPECT_NEAR(start.distance, 0.75, 0.001);
    EXPECT_TRUE(start.visible);
    EXPECT_TRUE(start.in_box);
    world.advance_to(10);
    EXPECT_EQ(world.truth().person_x, start.person_x);
    EXPECT_EQ(world.truth().person_y, start.person_y);
    world.command({});
    world.advance_to(15);
    EXPECT_NE(world.truth().person_x, start.person_x);
  }
}

TEST(World, shows_the_follower_the_distance_that_is_its_ground_truth) {
  Loop loop(2);
  for (int i = 0; i < 300; ++i) {
    const Followed followed = loop.step();
    ASSERT_FALSE(followed.lost());
    // Points beyond 1 m are outside the box, so the follower sees a striding person a little nearer.
    ASSERT_NEAR(followed.z, loop.truth.distance, 0.08) << "frame " << i;
  }
}

// A sanitizer looks for memory errors, for which the frames of the test above are enough.
#if !defined(IOTCLOUD_SANITIZED)
class ClosedLoop : public ::testing::TestWithParam<int> {};

TEST_P(ClosedLoop, follows_the_person_for_half_a_minute) {
  Loop loop(static_cast<std::uint64_t>(GetParam()));
  double error = 0, walked = 0;
  Pose before = loop.world.person().pose();
  constexpr int frames = 32 * 30;
  for (int i = 0; i < frames; ++i) {
    const Followed followed = loop.step(0.004);
    ASSERT_FALSE(followed.lost()) << "frame " << i;
    ASSERT_TRUE(loop.truth.visible) << "frame " << i;
    ASSERT_TRUE(loop.truth.in_box) << "frame " << i;
    error += std::abs(loop.truth.distance - 0.7);
    const Pose now = loop.world.person().pose();
    walked += std::hypot(now.x - before.x, now.y - before.y);
    before = now;
  }
  EXPECT_LT(error / frames, 0.25);
  EXPECT_GT(walked, 2.5);
}

INSTANTIATE_TEST_SUITE_P(Seeds, ClosedLoop, ::testing::Values(1, 2, 3, 11, 42));
#endif

TEST(ClosedLoopLimits, loses_the_person_when_the_commands_are_dropped) {
  World world(1);
  world.command({});
  world.advance_to(15);
  EXPECT_FALSE(world.truth().in_box);
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::simulator
