#include <cstdlib>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/robot/peer.h>

namespace iotcloud::drivers::turtle::robot {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::MockInstance;

const Descriptor turtle_descriptor = describe<TurtleDriver>("turtle", "test", true);
constexpr const char* secret = "0123456789abcdef";

/// A turtle driver; the test plays its robot.
class RobotLinkTest : public ::testing::Test {
 protected:
  explicit RobotLinkTest(PropertyMap properties = {}) {
    properties.insert({{"source", "robot"}, {"listen", "127.0.0.1:0"}, {"token", secret}});
    driver_.emplace(turtle_descriptor, properties);
  }
  void SetUp() override { ASSERT_TRUE(driver_->start()) << driver_->error(); }

  std::uint16_t port() {
    const std::string address = driver_->host().metadata().at("robot_listen");
    return static_cast<std::uint16_t>(std::atoi(address.substr(address.rfind(':') + 1).c_str()));
  }
  template <typename Condition>
  bool until(Condition holds) {
    return run_until(holds, [&] { driver_->host().poll_descriptors(1ms); });
  }
  std::optional<Incoming> next(Peer& peer) {
    std::optional<Incoming> message;
    until([&] { return (message = peer.take()) || peer.ended(); });
    return message;
  }
  /// Authenticates with this token. \return `start` or `stop`, or another kind when that fails.
  Kind shake_hands(Peer& peer, const std::string& token = secret) {
    Hello hello;
    hello.silence_ms = 1000;
    hello.nonce = random_nonce();
    hello.name = "rover";
    peer.send(write_hello(hello));
    const auto answer = next(peer);
    EXPECT_TRUE(answer);
    if (!answer || answer->kind != Kind::challenge) return answer ? answer->kind : Kind::refused;
    const Challenge challenge = read_challenge(*answer);
    EXPECT_TRUE(same_proof(challenge.proof, make_proof(Side::driver, secret, hello.nonce, challenge.nonce)));
    peer.send(write_proof(make_proof(Side::agent, token, hello.nonce, challenge.nonce)));
    const auto result = next(peer);
    return result ? result->kind : Kind::refused;
  }
  std::string robot_is() { return driver_->host().metadata().at("robot"); }
  std::vector<testing::MockHost::Published> frames() { return driver_->host().published("kinect"); }

  std::optional<MockInstance> driver_;
};

std::string frame(std::uint64_t number, const std::string& contents, bool repeated = false) {
  FrameHead head;
  head.number = number;
  head.repeated = repeated;
  return write_frame_head(head, contents.size()) + contents;
}

Message command(const Velocity& velocity, std::int64_t time_ms = 0) {
  Message message;
  message.payload = Payload::copy(R"({"linear":{"x":)" + std::to_string(velocity.linear) + R"(},"angular":{"z":)" +
                                  std::to_string(velocity.angular) + "}}");
  message.time_ms = time_ms;
  return message;
}

TEST_F(RobotLinkTest, passes_frames_on_as_they_came_and_commands_back) {
  EXPECT_EQ(robot_is(), "away");
  Peer peer = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(peer), Kind::start);
  EXPECT_EQ(robot_is(), "connected");
  const std::string contents(100'000, 'z');  // not decoded at all
  peer.send(frame(1, contents));
  ASSERT_TRUE(until([&] { return frames().size() == 1; }));
  EXPECT_EQ(frames()[0].message.payload.text(), contents);
  const auto got = next(peer);
  ASSERT_EQ(got->kind, Kind::got);
  EXPECT_EQ(read_number(*got), 1);

  ASSERT_TRUE(driver_->deliver("control", command({0.5, -0.25}, frames()[0].message.time_ms)));
  const auto drive = next(peer);
  ASSERT_EQ(drive->kind, Kind::drive);
  EXPECT_EQ(read_drive(*drive).linear, 0.5);
  const auto answered = next(peer);
  ASSERT_EQ(answered->kind, Kind::answered);
  EXPECT_EQ(read_number(*answered), 1);
  driver_->host().advance(100ms);
  peer.send(write_bare(Kind::alive));
  ASSERT_GT(driver_->host().poll_descriptors(10s), 0);
  driver_->host().advance(150ms);  // the driver's own watchdog
  EXPECT_EQ(next(peer)->kind, Kind::halt);
}

TEST_F(RobotLinkTest, tells_the_robot_whether_frames_are_wanted) {
  ASSERT_TRUE(driver_->deactivate());
  Peer peer = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(peer), Kind::stop);
  peer.send(frame(1, "late"));
  EXPECT_EQ(next(peer)->kind, Kind::got);
  EXPECT_TRUE(frames().empty());
  ASSERT_TRUE(driver_->activate());
  EXPECT_EQ(next(peer)->kind, Kind::start);
}

TEST_F(RobotLinkTest, takes_a_repeated_frame_for_new_when_its_first_sending_was_lost) {
  Peer first = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(first), Kind::start);
  first.send(frame(1, "a") + frame(1, "a", true));
  ASSERT_TRUE(until([&] { return frames().size() == 2; }));
  Peer second = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(second), Kind::start);
  second.send(frame(7, "b", true));
  ASSERT_TRUE(until([&] { return frames().size() == 3; }));
  EXPECT_EQ(*frames()[1].message.properties.find("seq"), "0");
  EXPECT_EQ(*frames()[2].message.properties.find("seq"), "1");
}

TEST_F(RobotLinkTest, lets_nobody_in_without_the_token) {
  Peer peer = Peer::connect_to(port());
  EXPECT_EQ(shake_hands(peer, "another secret!!"), Kind::refused);
  EXPECT_TRUE(until([&] { return peer.ended(); }));
  EXPECT_EQ(robot_is(), "away");
  EXPECT_EQ(driver_->host().logged_count("token is not the driver's"), 1);
  Peer hasty = Peer::connect_to(port());
  hasty.send(frame(1, "x"));
  EXPECT_TRUE(until([&] { return hasty.ended(); }));
  EXPECT_TRUE(frames().empty());
}

TEST_F(RobotLinkTest, hangs_up_on_garbage_and_hostile_lengths) {
  for (const std::string& bytes :
       {std::string("GET / HTTP/1.1\r\n\r\n"), std::string("\xff\xff\xff\xff\1", 5), std::string("\0\0\0\0\0", 5),
        write_bare(Kind::alive), write_hello({9, 0, {}, ""})}) {
    Peer peer = Peer::connect_to(port());
    peer.send(bytes);
    EXPECT_TRUE(until([&] { return peer.ended(); }));
  }
  Peer robot = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(robot), Kind::start);
  robot.send(std::string("\x7f\xff\xff\xff\7", 5));
  EXPECT_TRUE(until([&] { return robot.ended(); }));
  EXPECT_EQ(robot_is(), "away");
  EXPECT_EQ(driver_->host().logged_count("is away"), 1);
  EXPECT_FALSE(driver_->host().failed());
}

TEST_F(RobotLinkTest, has_room_for_few_who_do_not_say_who_they_are_and_not_for_long) {
  std::vector<Peer> crowd;
  for (int i = 0; i < 4; ++i) {
    crowd.push_back(Peer::connect_to(port()));
    driver_->host().poll_descriptors(1s);
  }
  Peer robot = Peer::connect_to(port());
  EXPECT_EQ(shake_hands(robot), Kind::start);
  EXPECT_TRUE(until([&] { return crowd[0].ended(); }));  // the oldest made room
  EXPECT_FALSE(crowd[3].ended());
  const auto long_enough = [&] {
    robot.send(write_bare(Kind::alive));
    driver_->host().poll_descriptors(1s);
    driver_->host().advance(100ms);
    return crowd[3].ended();
  };
  EXPECT_TRUE(run_until(long_enough, [] {}));
  EXPECT_EQ(robot_is(), "connected");
}

TEST_F(RobotLinkTest, notices_a_connection_that_is_dead_and_is_heard_itself) {
  Peer peer = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(peer), Kind::start);
  peer.pump();
  const int beats = peer.beats();
  driver_->host().advance(180ms);
  EXPECT_EQ(robot_is(), "connected");
  driver_->host().advance(70ms);  // together as long as the watchdog
  EXPECT_EQ(robot_is(), "away");
  EXPECT_TRUE(until([&] { return peer.ended(); }));
  EXPECT_EQ(peer.beats(), beats);  // it must be heard once a second
  EXPECT_EQ(driver_->host().logged_count("nothing was heard"), 1);

  Peer again = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(again), Kind::start);
  for (int i = 0; i < 10; ++i) {
    again.send(write_bare(Kind::alive));
    ASSERT_GT(driver_->host().poll_descriptors(10s), 0);
    driver_->host().advance(100ms);
  }
  EXPECT_EQ(robot_is(), "connected");
  EXPECT_TRUE(until([&] {
    again.pump();
    return again.beats() == 4;
  }));
}

TEST_F(RobotLinkTest, gives_the_robot_s_place_to_the_one_that_came_last) {
  Peer old = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(old), Kind::start);
  Peer back = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(back), Kind::start);
  EXPECT_TRUE(until([&] { return old.ended(); }));
  EXPECT_EQ(robot_is(), "connected");
  back.send(frame(1, "new"));
  EXPECT_TRUE(until([&] { return frames().size() == 1; }));
}

TEST_F(RobotLinkTest, ends_with_the_instance) {
  Peer peer = Peer::connect_to(port());
  ASSERT_EQ(shake_hands(peer), Kind::start);
  const auto address = driver_->host().metadata().at("robot_listen");
  MockInstance second(turtle_descriptor, {{"source", "robot"}, {"listen", address}});
  EXPECT_FALSE(second.open());
  EXPECT_THAT(second.error(), AllOf(HasSubstr(address), HasSubstr("port of its own")));
  driver_->close();
  EXPECT_TRUE(run_until([&] { return peer.ended(); }, [] {}));
  EXPECT_EQ(driver_->host().logged_count("1 connections of a robot"), 1);
  MockInstance third(turtle_descriptor, {{"source", "robot"}, {"listen", address}});
  EXPECT_TRUE(third.open()) << third.error();
}

TEST(RobotKind, wants_a_token_beyond_this_machine) {
  const auto error_with = [](PropertyMap properties) {
    properties["source"] = "robot";
    MockInstance driver(turtle_descriptor, properties);
    EXPECT_FALSE(driver.open());
    return driver.error();
  };
  EXPECT_THAT(error_with({{"listen", "0.0.0.0:0"}}), AllOf(HasSubstr("\"token\""), HasSubstr("other machines")));
  EXPECT_THAT(error_with({{"listen", "0.0.0.0:0"}, {"token", "short"}}), HasSubstr("16"));
  EXPECT_THAT(error_with({{"listen", "somewhere"}}), HasSubstr("somewhere"));
  EXPECT_THAT(error_with({{"silence_ms", "1"}}), HasSubstr("silence_ms"));
  EXPECT_THAT(error_with({{"actuator", "simulator"}}), HasSubstr("simulator"));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::robot
