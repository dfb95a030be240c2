#include <algorithm>
#include <chrono>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/drivers/turtle/turtle_fixture.h>

namespace iotcloud::drivers::turtle {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::MockInstance;

TEST(TurtleDriver, wants_newest_frames_out_and_the_last_command_in) {
  MockInstance robot(turtle, {{"broker", "rabbit"}});
  ASSERT_TRUE(robot.open()) << robot.error();
  ASSERT_EQ(robot.channels().size(), 2);
  const ChannelSpec& kinect = robot.channels()[0];
  EXPECT_EQ(kinect.name, "kinect");
  EXPECT_EQ(kinect.direction, Direction::out);
  EXPECT_EQ(kinect.when_full, WhenFull::keep_newest);
  EXPECT_LE(kinect.capacity, 2);
  EXPECT_EQ(kinect.deadline, 200ms);
  EXPECT_FALSE(kinect.shared);
  EXPECT_EQ(kinect.broker, "rabbit");
  const ChannelSpec& control = robot.channels()[1];
  EXPECT_EQ(control.name, "control");
  EXPECT_EQ(control.direction, Direction::in);
  EXPECT_EQ(control.keep_last, 1);
  EXPECT_FALSE(control.shared);
  EXPECT_EQ(control.broker, "rabbit");
}

TEST(TurtleDriver, says_which_property_is_wrong_and_what_would_be_right) {
  const auto error_with = [](const PropertyMap& properties) {
    MockInstance robot(turtle, properties);
    EXPECT_FALSE(robot.open());
    return robot.error();
  };
  EXPECT_THAT(error_with({{"sed", "1"}}), AllOf(HasSubstr("\"sed\""), HasSubstr("did you mean \"seed\"?")));
  EXPECT_THAT(error_with({{"source", "sonar"}}), AllOf(HasSubstr("source"), HasSubstr("simulator")));
  EXPECT_THAT(error_with({{"actuator", "ros"}}), AllOf(HasSubstr("actuator"), HasSubstr("simulator")));
  EXPECT_THAT(error_with({{"rate", "fast"}}), AllOf(HasSubstr("rate"), HasSubstr("fast"), HasSubstr("120")));
  EXPECT_THAT(error_with({{"rate", "nan"}}), HasSubstr("rate"));
  EXPECT_THAT(error_with({{"rate", "0"}}), HasSubstr("rate"));
  EXPECT_THAT(error_with({{"watchdog_ms", "1"}}), HasSubstr("watchdog_ms"));
  EXPECT_THAT(error_with({{"codec", "zip"}}), AllOf(HasSubstr("codec"), HasSubstr("reference, compact, lossless")));
  EXPECT_THAT(error_with({{"clock", "sundial"}}), AllOf(HasSubstr("realtime"), HasSubstr("lockstep")));
  EXPECT_THAT(error_with({{"trace", "/dev/null/folder/t.csv"}}), HasSubstr("/dev/null/folder/t.csv"));
  MockInstance robot(turtle, {{"channel.kinect.capacity", "1"}});
  EXPECT_TRUE(robot.open()) << robot.error();
}

TEST(TurtleDriver, publishes_frames_at_its_rate_each_with_a_time_of_its_own) {
  MockInstance robot(turtle, {{"rate", "20"}});
  ASSERT_TRUE(robot.start()) << robot.error();
  robot.host().advance(1s);
  const auto frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 20);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Message& frame = frames[i].message;
    ASSERT_NE(frame.properties.find("seq"), nullptr);
    EXPECT_EQ(*frame.properties.find("seq"), std::to_string(i));
    // The test's clock runs faster than the wall's, yet no two frames share a time.
    if (i > 0) {
      EXPECT_GT(frame.time_ms, frames[i - 1].message.time_ms);
    }
  }
  EXPECT_FALSE(follow(depth::FrameView(decoded(frames.front().message))).lost());
}

TEST(TurtleDriver, stops_after_the_number_of_frames_asked_for) {
  MockInstance robot(turtle, {{"frames", "3"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(1s);
  EXPECT_EQ(robot.host().published("kinect").size(), 3);
}

TEST(TurtleDriver, produces_only_while_active) {
  MockInstance robot(turtle);
  ASSERT_TRUE(robot.open());
  robot.host().advance(200ms);
  EXPECT_TRUE(robot.host().published().empty());
  ASSERT_TRUE(robot.activate());
  robot.host().advance(200ms);
  EXPECT_EQ(robot.host().published().size(), 6);
  ASSERT_TRUE(robot.deactivate());
  robot.host().advance(200ms);
  EXPECT_EQ(robot.host().published().size(), 6);
  ASSERT_TRUE(robot.activate());
  robot.host().advance(200ms);
  EXPECT_EQ(robot.host().published().size(), 12);
}

TEST(TurtleDriver, says_where_the_robot_is_when_it_has_gone_a_quarter_of_a_metre) {
  MockInstance robot(turtle);
  ASSERT_TRUE(robot.start());
  robot.host().advance(100ms);
  const std::string first = robot.host().metadata().at("position");
  EXPECT_NE(first.find(','), std::string::npos);
  const auto back = [&](int tenths) {
    for (int i = 0; i < tenths; ++i) {
      ASSERT_TRUE(robot.deliver("control", command(Velocity{-0.2, 0})));
      robot.host().advance(100ms);
    }
  };
  back(10);
  EXPECT_EQ(robot.host().metadata().at("position"), first);
  back(10);
  EXPECT_NE(robot.host().metadata().at("position"), first);
}

TEST(TurtleDriver, moves_the_robot_as_commanded) {
  ScratchFile trace("moves.csv");
  MockInstance robot(turtle, {{"trace", trace.path()}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(34ms);
  for (int i = 0; i < 10; ++i) {
    ASSERT_TRUE(robot.deliver("control", command(Velocity{-0.2, 0.5})));
    robot.host().advance(100ms);
  }
  robot.close();
  const auto rows = trace.rows();
  ASSERT_EQ(rows.size(), 31);
  const auto& first = rows.front();
  const auto& last = rows.back();
  // Back off for a second at 0.2 m/s, less the time that the base takes to get there.
  const double moved = std::hypot(number(last, "robot_x") - number(first, "robot_x"),
                                  number(last, "robot_y") - number(first, "robot_y"));
  EXPECT_NEAR(moved, 0.17, 0.04);
  EXPECT_GT(number(last, "distance"), number(first, "distance") + 0.1);
  const double turned = std::remainder(number(last, "robot_heading") - number(first, "robot_heading"), 2 * M_PI);
  EXPECT_NEAR(turned, 0.48, 0.06);
}

TEST(TurtleDriver, stops_the_robot_when_no_command_came_for_a_while) {
  ScratchFile trace("watchdog.csv");
  MockInstance robot(turtle, {{"trace", trace.path()}, {"watchdog_ms", "200"}, {"rate", "100"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(10ms);
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0, 1.0})));
  robot.host().advance(1s);
  EXPECT_EQ(robot.host().logged_count("no command for 200 ms"), 1);
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0, 1.0})));  // and starts again
  robot.host().advance(100ms);
  robot.close();
  const auto rows = trace.rows();
  const auto heading = [&](std::size_t row) { return number(rows.at(row), "robot_heading"); };
  const auto turned = [&](std::size_t from, std::size_t to) {
    return std::remainder(heading(to) - heading(from), 2 * M_PI);
  };
  EXPECT_GT(turned(0, 15), 0.05);         // it turned at first,
  EXPECT_NEAR(turned(0, 30), 0.2, 0.06);  // some 0.2 s long;
  EXPECT_DOUBLE_EQ(turned(40, 99), 0);    // it stood well before the base's own 0.6 s,
  EXPECT_GT(turned(100, 109), 0.02);      // and turned when told again.
}

TEST(TurtleDriver, ignores_malformed_commands_and_logs_a_burst_once) {
  MockInstance robot(turtle, {{"rate", "100"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(10ms);
  const auto frame = robot.host().published("kinect").at(0).message;
  const std::string deep(3000, '[');
  for (const std::string& text :
       {std::string(), std::string("stop"), std::string("{}"), std::string("[]"), std::string("null"),
        std::string(R"({"linear":1,"angular":2})"), std::string(R"({"linear":{"x":"1"},"angular":{"z":0}})"),
        std::string(R"({"linear":{"x":1},"angular":{}})"), std::string(R"({"linear":{"x":1e999},"angular":{"z":0}})"),
        std::string(R"({"linear":{"x":1},"angular":{"z":0})"), std::string("\xff\xfe\x00\x01", 4), deep,
        std::string(100'000, ' ')}) {
    EXPECT_TRUE(robot.deliver("control", command(text, frame.time_ms))) << text.substr(0, 60) << robot.error();
  }
  EXPECT_EQ(robot.host().logged_count("is ignored"), 1);
  EXPECT_FALSE(robot.host().failed());
  robot.close();
  EXPECT_EQ(robot.host().logged_count("0 answered"), 1);
  EXPECT_EQ(robot.host().logged_count("13 malformed"), 1);
}

TEST(TurtleDriver, tells_pages_which_frames_were_answered_and_where_all_is_in_a_simulation) {
  MockInstance robot(turtle, {{"frames", "3"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(34ms);
  const auto first = robot.host().published("kinect").at(0).message;
  EXPECT_EQ(first.properties.find("answers"), nullptr);
  double x = 0, y = 0, heading = 0, person_x = 0, person_y = 0, distance = 0;
  ASSERT_NE(first.properties.find("truth"), nullptr);
  ASSERT_EQ(std::sscanf(first.properties.find("truth")->c_str(), "%lf,%lf,%lf,%lf,%lf,%lf", &x, &y, &heading, &person_x,
                        &person_y, &distance),
            6);
  EXPECT_NEAR(std::hypot(person_x - x, person_y - y), distance + 0.055, 0.002);  // to the person's surface
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0.1, 0}, first.time_ms)));
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0.1, 0}, first.time_ms)));  // again: no other answer
  robot.host().advance(100ms);
  const auto frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 3);
  ASSERT_NE(frames[1].message.properties.find("answers"), nullptr);
  EXPECT_THAT(*frames[1].message.properties.find("answers"), ::testing::MatchesRegex("0:[0-9]+"));
  EXPECT_EQ(frames[2].message.properties.find("answers"), nullptr);
}

TEST(TurtleDriver, measures_from_a_frame_to_the_command_that_carries_its_time) {
  ScratchFile trace("latency.csv");
  MockInstance robot(turtle, {{"trace", trace.path()}, {"frames", "3"}});
  ASSERT_TRUE(robot.start());
  robot.host().advance(100ms);
  const auto frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 3);
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0.1, -0.2}, frames[1].message.time_ms)));
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0.3, 0.0}, frames[1].message.time_ms)));  // again: not counted
  ASSERT_TRUE(robot.deliver("control", command(Velocity{0.3, 0.0}, 12345)));                      // no frame's time
  robot.close();
  const auto rows = trace.rows();
  ASSERT_EQ(rows.size(), 3);
  EXPECT_EQ(rows[0].at("answered"), "0");
  EXPECT_EQ(rows[0].at("latency_us"), "");
  EXPECT_EQ(rows[1].at("answered"), "1");
  EXPECT_EQ(rows[1].at("time_ms"), std::to_string(frames[1].message.time_ms));
  EXPECT_GT(number(rows[1], "latency_us"), 0);
  EXPECT_DOUBLE_EQ(number(rows[1], "linear"), 0.1);
  EXPECT_DOUBLE_EQ(number(rows[1], "angular"), -0.2);
  EXPECT_EQ(rows[2].at("answered"), "0");
  EXPECT_EQ(rows[1].at("raw_bytes"), "614400");
  EXPECT_EQ(rows[1].at("payload_bytes"), std::to_string(frames[1].message.payload.size()));
  EXPECT_EQ(robot.host().logged_count("3 frames, 1 answered"), 1);
}

TEST(TurtleDriver, notes_what_the_channel_did_not_take) {
  ScratchFile trace("refused.csv");
  MockInstance robot(turtle, {{"trace", trace.path()}});
  ASSERT_TRUE(robot.start());
  robot.host().answer_publish("kinect", PublishStatus::would_block);
  robot.host().advance(100ms);
  robot.close();
  const auto rows = trace.rows();
  ASSERT_EQ(rows.size(), 3);
  EXPECT_EQ(rows[0].at("published"), "would_block");
  EXPECT_EQ(robot.host().logged_count("3 not taken"), 1);
}

TEST(TurtleDriver, has_the_same_frames_for_the_same_seed) {
  const auto first_frames = [](const std::string& seed) {
    MockInstance robot(turtle, {{"seed", seed}, {"frames", "3"}});
    EXPECT_TRUE(robot.start());
    robot.host().advance(200ms);
    std::vector<std::string> payloads;
    for (const auto& frame : robot.host().published("kinect")) payloads.emplace_back(frame.message.payload.text());
    return payloads;
  };
  const auto once = first_frames("5"), again = first_frames("5"), other = first_frames("6");
  ASSERT_EQ(once.size(), 3);
  EXPECT_EQ(once, again);
  EXPECT_NE(once, other);
  EXPECT_NE(once[0], once[1]);  // the noise is new in each frame
}

TEST(TurtleDriver, encodes_its_frames_with_the_codec_that_it_is_told) {
  const auto frames_of = [](const std::string& codec) {
    MockInstance robot(turtle, {{"codec", codec}, {"frames", "2"}});
    EXPECT_TRUE(robot.start()) << robot.error();
    robot.host().advance(200ms);
    std::vector<Message> frames;
    for (const auto& frame : robot.host().published("kinect")) frames.push_back(frame.message);
    return frames;
  };
  const auto reference = frames_of("reference"), compact = frames_of("compact"), lossless = frames_of("lossless");
  ASSERT_EQ(reference.size(), 2);
  ASSERT_EQ(compact.size(), 2);
  ASSERT_EQ(lossless.size(), 2);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(decoded(compact[i]), decoded(reference[i]));
    EXPECT_LT(compact[i].payload.size() * 2, reference[i].payload.size());
    EXPECT_NE(decoded(lossless[i]), decoded(reference[i]));
  }
  depth::DepthDecoder decoder;
  std::vector<std::uint16_t> disparities(depth::frame_pixels);
  EXPECT_EQ(decoder.decode_disparities(lossless[0].payload.bytes(), depth::FrameSpan(disparities)),
            depth::DecodeError::none);
}

}  // namespace
}  // namespace iotcloud::drivers::turtle
