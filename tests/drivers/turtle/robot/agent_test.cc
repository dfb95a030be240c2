#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/robot/address.h>
#include <iotcloud/drivers/turtle/robot/agent.h>
#include <iotcloud/drivers/turtle/standalone/device_host.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/reference_follower.h>
#include <iotcloud/tests/drivers/turtle/robot/peer.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::drivers::turtle::robot {
namespace {

using namespace std::chrono_literals;
using testing::MockInstance;

constexpr const char* agent_secret = "0123456789abcdef";

/// A robot that the test moves by hand.
class HandHeld final : public DepthSource, public Actuator {
 public:
  void start(std::function<void(const DepthFrame&)> on_frame) override {
    on_frame_ = std::move(on_frame);
    ++starts;
  }
  void stop() override { on_frame_ = nullptr; }
  void drive(const Velocity& velocity) override { driven.push_back(velocity); }
  void halt() override { ++halts; }
  void answered() override { ++answers; }

  bool running() const { return on_frame_ != nullptr; }
  /// A frame whose every pixel is this disparity.
  void see(std::uint16_t disparity) {
    const std::vector<std::uint16_t> disparities(depth::frame_pixels, disparity);
    on_frame_({depth::FrameView(disparities), std::chrono::steady_clock::now(), 1.5, false, nullptr, {}});
  }

  int starts = 0, halts = 0, answers = 0;
  std::vector<Velocity> driven;

 private:
  std::function<void(const DepthFrame&)> on_frame_;
};

class AgentTest : public ::testing::Test {
 protected:
  AgentTest()
      : host_(
            loop_, {}, [this](LogLevel, std::string_view text) { log_ += std::string(text) + "\n"; },
            [this](const std::string& reason) { failure_ = reason; }),
        listener_(listen_at("127.0.0.1:0")) {
    options_.driver = address_of(listener_);
    options_.token = agent_secret;
    options_.name = "rover";
    // Where they are not the test's subject, a slow machine must not end a connection.
    options_.silence = options_.handshake = 1min;
    options_.reconnect = 2ms;
    turtle_.watchdog = 1min;
    turtle_.make_device = [this](DriverContext&) { return Device{robot_, robot_}; };
  }
  ~AgentTest() override {
    agent_.reset();
    close(listener_);
  }

  void start() {
    agent_ = std::make_unique<Agent>(loop_, options_, turtle_, context_);
    agent_->start();
  }
  template <typename Condition>
  bool until(Condition holds) {
    return run_until(holds, [this] { loop_.poll(); });
  }
  /// The agent's next connection.
  Peer accepted() {
    int socket = -1;
    EXPECT_TRUE(until([&] { return (socket = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC)) >= 0; }));
    return Peer(socket);
  }
  std::optional<Incoming> next(Peer& peer) {
    std::optional<Incoming> message;
    until([&] { return (message = peer.take()) || peer.ended(); });
    return message;
  }
  /// Greets the agent as its driver. \return the kind of what it says then: `proof`.
  Kind greet(Peer& peer, const std::string& token = agent_secret, std::uint32_t silence_ms = 60'000) {
    const auto first = next(peer);
    if (!first) return Kind::refused;
    const Hello hello = read_hello(*first);
    EXPECT_EQ(hello.name, "rover");
    Challenge challenge;
    challenge.silence_ms = silence_ms;
    challenge.nonce = random_nonce();
    challenge.proof = make_proof(Side::driver, token, hello.nonce, challenge.nonce);
    peer.send(write_challenge(challenge));
    const auto answer = next(peer);
    if (!answer) return Kind::refused;
    EXPECT_TRUE(same_proof(read_proof(*answer), make_proof(Side::agent, agent_secret, hello.nonce, challenge.nonce)));
    return answer->kind;
  }
  /// A driver that wants frames.
  Peer started() {
    Peer peer = accepted();
    EXPECT_EQ(greet(peer), Kind::proof);
    peer.send(write_bare(Kind::start));
    EXPECT_TRUE(until([&] { return robot_->running(); }));
    return peer;
  }
  FrameHead frame(Peer& peer, std::uint16_t& disparity) {
    const auto message = next(peer);
    EXPECT_TRUE(message && message->kind == Kind::frame);
    if (!message || message->kind != Kind::frame) return {};
    Payload encoded;
    const FrameHead head = read_frame(*message, encoded);
    depth::DepthDecoder decoder;
    std::vector<std::uint16_t> mm(depth::frame_pixels);
    EXPECT_EQ(decoder.decode(encoded.bytes(), depth::FrameSpan(mm)), depth::DecodeError::none);
    for (disparity = 61; depth::mm_table()[depth::code_table()[disparity]] != mm[0] && disparity < 1011;) ++disparity;
    return head;
  }

  boost::asio::io_context loop_;
  std::string log_, failure_;
  DeviceHost host_;
  DriverContext context_{host_};
  int listener_;
  AgentOptions options_;
  TurtleOptions turtle_;
  std::shared_ptr<HandHeld> robot_ = std::make_shared<HandHeld>();
  std::unique_ptr<Agent> agent_;
};

TEST_F(AgentTest, sends_frames_and_obeys_commands) {
  start();
  Peer driver = started();
  robot_->see(200);
  std::uint16_t seen = 0;
  const FrameHead head = frame(driver, seen);
  EXPECT_EQ(head.number, 1);
  EXPECT_EQ(head.device_time_s, 1.5);
  EXPECT_FALSE(head.repeated);
  EXPECT_EQ(depth::code_table()[seen], depth::code_table()[200]);
  driver.send(write_number(Kind::got, 1) + write_drive({0.5, -1}) + write_number(Kind::answered, 1) +
              write_number(Kind::answered, 77));
  ASSERT_TRUE(until([&] { return robot_->answers == 1; }));
  ASSERT_EQ(robot_->driven.size(), 1);
  EXPECT_EQ(robot_->driven[0].linear, 0.5);
  EXPECT_EQ(robot_->driven[0].angular, -1);
  driver.send(write_bare(Kind::halt));
  EXPECT_TRUE(until([&] { return robot_->halts == 1; }));
  driver.send(write_bare(Kind::stop));
  EXPECT_TRUE(until([&] { return !robot_->running(); }));
  EXPECT_EQ(robot_->halts, 2);
  EXPECT_EQ(robot_->answers, 1);
}

TEST_F(AgentTest, keeps_the_newest_frame_when_the_way_is_slow) {
  start();
  Peer driver = started();
  for (std::uint16_t disparity = 200; disparity < 220; ++disparity) robot_->see(disparity);
  EXPECT_EQ(agent_->counts().sent, 2);  // under way
  EXPECT_EQ(agent_->counts().superseded, 17);
  std::uint16_t seen = 0;
  EXPECT_EQ(frame(driver, seen).number, 1);
  EXPECT_EQ(frame(driver, seen).number, 2);
  for (int i = 0; i < 100; ++i) loop_.poll();
  EXPECT_EQ(driver.waiting(), 0);  // until the driver has one
  driver.send(write_number(Kind::got, 1));
  EXPECT_EQ(frame(driver, seen).number, 20);
  EXPECT_EQ(depth::code_table()[seen], depth::code_table()[219]);
  driver.send(write_number(Kind::got, 2) + write_number(Kind::got, 20));
  robot_->see(300);
  EXPECT_EQ(frame(driver, seen).number, 21);
  EXPECT_EQ(agent_->counts().superseded, 17);
}

TEST_F(AgentTest, stops_the_robot_when_no_command_comes) {
  turtle_.watchdog = 20ms;
  start();
  Peer driver = started();
  for (int i = 0; i < 100; ++i) loop_.poll();
  EXPECT_EQ(robot_->halts, 0);  // it does not move yet
  driver.send(write_drive({0.5, 0}));
  ASSERT_TRUE(until([&] { return robot_->halts == 1; }));
  EXPECT_EQ(robot_->driven.size(), 1);
  EXPECT_EQ(agent_->counts().watchdog_stops, 1);
  EXPECT_NE(log_.find("no command for 20 ms"), std::string::npos);
  driver.send(write_drive({0.5, 0}));
  EXPECT_TRUE(until([&] { return robot_->driven.size() == 2; }));
  EXPECT_TRUE(until([&] { return robot_->halts == 2; }));
}

TEST_F(AgentTest, stops_the_robot_when_the_link_is_cut_and_comes_back) {
  start();
  {
    Peer driver = started();
    driver.send(write_drive({0.5, 0}));
    ASSERT_TRUE(until([&] { return !robot_->driven.empty(); }));
    EXPECT_EQ(robot_->halts, 0);
  }
  ASSERT_TRUE(until([&] { return robot_->halts == 1; }));
  EXPECT_EQ(agent_->counts().link_stops, 1);
  robot_->see(200);  // the source goes on, for nobody
  EXPECT_EQ(agent_->counts().unwanted, 1);
  Peer again = started();
  EXPECT_EQ(robot_->starts, 1);
  EXPECT_EQ(agent_->counts().connects, 2);
  EXPECT_EQ(agent_->counts().lost, 1);
  // As soon as the new driver has said that it wants them.
  ASSERT_TRUE(until([&] {
    if (agent_->counts().sent == 0) robot_->see(300);
    return again.waiting() > 0;
  }));
  std::uint16_t seen = 0;
  EXPECT_EQ(frame(again, seen).number, agent_->counts().frames);
}

TEST_F(AgentTest, notices_a_link_that_is_dead_and_is_heard_itself) {
  options_.silence = 60ms;
  start();
  Peer driver = accepted();
  ASSERT_EQ(greet(driver, agent_secret, 20), Kind::proof);
  driver.send(write_bare(Kind::start) + write_drive({0.5, 0}));
  ASSERT_TRUE(until([&] { return robot_->driven.size() == 1; }));
  // The socket stays open, and nothing comes: a laptop that was carried out of the radio's reach.
  ASSERT_TRUE(until([&] { return robot_->halts == 1; }));
  EXPECT_NE(log_.find("nothing was heard"), std::string::npos);
  driver.pump();
  EXPECT_GE(driver.beats(), 1);  // four times in 20 ms; how often there was time depends on the machine
  Peer again = started();
}

TEST_F(AgentTest, tries_again_until_there_is_a_driver_and_says_so_once) {
  close(listener_);
  const std::string address = "127.0.0.1:" + std::to_string(iotcloud::tests::free_port());
  options_.driver = address;
  start();
  ASSERT_TRUE(until([&] { return log_.find("no connection") != std::string::npos; }));
  ASSERT_TRUE(until([&] { return agent_->counts().attempts >= 4; }));
  listener_ = listen_at(address);
  Peer driver = started();
  EXPECT_EQ(log_.find("no connection"), log_.rfind("no connection"));
  EXPECT_EQ(agent_->counts().connects, 1);
}

TEST_F(AgentTest, obeys_nobody_who_does_not_know_the_token) {
  start();
  Peer stranger = accepted();
  EXPECT_EQ(greet(stranger, "another secret!!"), Kind::refused);
  EXPECT_TRUE(until([&] { return stranger.ended(); }));
  EXPECT_NE(log_.find("token is not this robot's"), std::string::npos);
  Peer hasty = accepted();
  ASSERT_TRUE(next(hasty));
  hasty.send(write_drive({1, 1}));
  EXPECT_TRUE(until([&] { return hasty.ended(); }));
  EXPECT_TRUE(robot_->driven.empty());
  Peer refusing = accepted();
  ASSERT_TRUE(next(refusing));
  refusing.send(write_refused("full"));
  EXPECT_TRUE(until([&] { return refusing.ended(); }));
  Peer driver = started();
}

TEST_F(AgentTest, hangs_up_on_garbage_and_hostile_lengths) {
  start();
  for (const std::string& bytes : {std::string("HTTP/1.1 400 Bad Request\r\n\r\n"), std::string("\0\1\0\0\2", 5)}) {
    Peer peer = accepted();
    ASSERT_TRUE(next(peer));
    peer.send(bytes);
    EXPECT_TRUE(until([&] { return peer.ended(); }));
  }
  for (const std::string& bytes :
       {std::string("\0\1\0\0\11", 5), std::string("\0\0\0\2\11x", 6), std::string("\0\0\0\1\143", 5)}) {
    const int halts = robot_->halts;
    Peer driver = started();
    driver.send(bytes);
    EXPECT_TRUE(until([&] { return driver.ended(); }));
    EXPECT_GT(robot_->halts, halts);
  }
  EXPECT_EQ(failure_, "");
}

/// Agent and driver, each as it is, over loopback; the test is the topology, which answers each frame. The world is in
/// lock step: as slow as the machine needs.
TEST(RobotLoop, a_robot_in_the_agent_follows_the_person_by_way_of_the_driver) {
  MockInstance driver(describe<TurtleDriver>("turtle", "test", true),
                      {{"source", "robot"}, {"listen", "127.0.0.1:0"}, {"silence_ms", "60000"}});
  ASSERT_TRUE(driver.start()) << driver.error();
  boost::asio::io_context loop;
  DeviceHost host(
      loop, {}, [](LogLevel, std::string_view) {}, [](const std::string&) {});
  DriverContext context(host);
  AgentOptions options;
  options.driver = driver.host().metadata().at("robot_listen");
  options.silence = options.handshake = 1min;
  const auto turtle = read_options({{"clock", "lockstep"}, {"seed", "3"}, {"retry_ms", "60000"}}, shipped_kinds());
  Agent agent(loop, options, turtle, context);
  agent.start();

  constexpr std::size_t frames = 60;
  std::size_t answered = 0, followed = 0;
  depth::DepthDecoder decoder;
  std::vector<std::uint16_t> mm(depth::frame_pixels);
  const auto work = [&] {
    loop.poll();
    driver.host().poll_descriptors(0ms);
    const auto sent = driver.host().published("kinect");
    driver.host().forget_published();
    for (const auto& frame : sent) {
      ASSERT_EQ(decoder.decode(frame.message.payload.bytes(), depth::FrameSpan(mm)), depth::DecodeError::none);
      const Followed found = follow(depth::FrameView(mm));
      if (!found.lost()) ++followed;
      Message command;
      command.payload = Payload::copy(as_json(found.command));
      command.time_ms = frame.message.time_ms;
      ASSERT_TRUE(driver.deliver("control", command));
      ++answered;
    }
  };
  ASSERT_TRUE(run_until([&] { return answered >= frames; }, work));
  EXPECT_EQ(followed, answered);  // the person was never lost
  EXPECT_EQ(agent.counts().superseded, 0);
  EXPECT_EQ(driver.host().logged_count("is connected"), 1);
  agent.stop();
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::robot
