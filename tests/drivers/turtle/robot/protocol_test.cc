#include <cmath>
#include <limits>
#include <random>

#include <gmock/gmock.h>

#include <iotcloud/drivers/turtle/robot/address.h>
#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {
namespace {

using ::testing::HasSubstr;

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

/// The one message in these bytes.
Incoming incoming(const std::string& text, std::size_t most = most_to_driver) {
  MessageReader reader(most);
  auto bytes = bytes_of(text);
  const auto message = reader.take(bytes);
  EXPECT_TRUE(message);
  EXPECT_TRUE(bytes.empty());
  return *message;
}

Incoming with_body(Kind kind, const std::string& body) {
  const auto bytes = bytes_of(body);
  return {kind, std::make_shared<const std::vector<std::byte>>(bytes.begin(), bytes.end())};
}

std::string body_of(const Incoming& message) {
  return {reinterpret_cast<const char*>(message.body->data()), message.body->size()};
}

TEST(RobotProtocol, brings_each_message_over) {
  const Nonce nonce = random_nonce();
  const Hello hello = read_hello(incoming(write_hello({protocol_version, 250, nonce, "rover"}), most_before_proof));
  EXPECT_EQ(hello.silence_ms, 250);
  EXPECT_EQ(hello.nonce, nonce);
  EXPECT_EQ(hello.name, "rover");
  const Proof proof = make_proof(Side::driver, "secret", nonce, nonce);
  const Challenge challenge = read_challenge(incoming(write_challenge({300, nonce, proof}), most_before_proof));
  EXPECT_EQ(challenge.silence_ms, 300);
  EXPECT_EQ(challenge.proof, proof);
  EXPECT_EQ(read_proof(incoming(write_proof(proof), most_before_proof)), proof);
  EXPECT_EQ(read_refused(incoming(write_refused("no\n"), most_before_proof)), "no?");
  const Velocity velocity = read_drive(incoming(write_drive({0.25, -3.5}), most_to_agent));
  EXPECT_EQ(velocity.linear, 0.25);
  EXPECT_EQ(velocity.angular, -3.5);
  EXPECT_EQ(read_number(incoming(write_number(Kind::got, UINT64_MAX), most_to_agent)), UINT64_MAX);
  EXPECT_EQ(incoming(write_bare(Kind::halt), most_to_agent).kind, Kind::halt);
}

TEST(RobotProtocol, brings_a_frame_over_without_touching_it) {
  FrameHead head;
  head.number = 77;
  head.age_us = 1234;
  head.device_time_s = 5.25;
  head.repeated = true;
  head.truth.emplace();
  head.truth->person_y = -1.5;
  head.truth->in_box = true;
  const Incoming message = incoming(write_frame_head(head, 5) + "depth");
  Payload encoded;
  const FrameHead read = read_frame(message, encoded);
  EXPECT_EQ(read.number, 77);
  EXPECT_EQ(read.age_us, 1234);
  EXPECT_EQ(read.device_time_s, 5.25);
  EXPECT_TRUE(read.repeated);
  EXPECT_FALSE(read.lock_step);
  ASSERT_TRUE(read.truth);
  EXPECT_EQ(read.truth->person_y, -1.5);
  EXPECT_TRUE(read.truth->in_box);
  EXPECT_FALSE(read.truth->visible);
  EXPECT_EQ(encoded.text(), "depth");
  EXPECT_EQ(encoded.data(), message.body->data() + message.body->size() - 5);  // shared, not copied
}

TEST(RobotProtocol, cuts_a_stream_into_messages_wherever_it_is_cut) {
  const std::string stream = write_drive({1, 2}) + write_bare(Kind::alive) + write_frame_head({}, 3) + "abc";
  for (std::size_t piece = 1; piece <= stream.size(); ++piece) {
    MessageReader reader(most_to_driver);
    std::vector<Kind> kinds;
    for (std::size_t at = 0; at < stream.size(); at += piece) {
      auto bytes = bytes_of(stream).subspan(at, std::min(piece, stream.size() - at));
      while (const auto message = reader.take(bytes)) kinds.push_back(message->kind);
      EXPECT_TRUE(bytes.empty());
    }
    EXPECT_EQ(kinds, (std::vector{Kind::drive, Kind::alive, Kind::frame})) << piece;
  }
}

TEST(RobotProtocol, refuses_lengths_of_nothing_and_beyond_the_limit_before_it_takes_memory) {
  for (const std::string& head :
       {std::string("\0\0\0\0\7", 5), std::string("\xff\xff\xff\xff\7", 5), std::string("\0\0\1\1\7", 5)}) {
    MessageReader reader(256);
    auto bytes = bytes_of(head);
    EXPECT_THROW(reader.take(bytes), ProtocolError);
  }
  MessageReader reader(256);
  const std::string longest("\0\0\1\0\7", 5);
  auto bytes = bytes_of(longest);
  EXPECT_FALSE(reader.take(bytes));
}

TEST(RobotProtocol, trusts_no_body) {
  Payload encoded;
  const std::string frame = body_of(incoming(write_frame_head({}, 1) + "x"));
  for (std::size_t size = 0; size < frame.size(); ++size) {
    EXPECT_THROW(read_frame(with_body(Kind::frame, frame.substr(0, size)), encoded), ProtocolError) << size;
  }
  std::string flags = frame;
  flags[20] = '\x20';
  EXPECT_THROW(read_frame(with_body(Kind::frame, flags), encoded), ProtocolError);
  const std::string drive = body_of(incoming(write_drive({1, 2})));
  EXPECT_THROW(read_drive(with_body(Kind::drive, drive + "x")), ProtocolError);
  EXPECT_THROW(read_drive(with_body(Kind::drive, drive.substr(1))), ProtocolError);
  for (const double value : {std::numeric_limits<double>::infinity(), std::nan("")}) {
    EXPECT_THROW(read_drive(incoming(write_drive({value, 0}))), ProtocolError);
    EXPECT_THROW(read_drive(incoming(write_drive({0, value}))), ProtocolError);
  }
  EXPECT_THROW(read_number(with_body(Kind::got, "1234567")), ProtocolError);
  EXPECT_THROW(read_proof(with_body(Kind::proof, "short")), ProtocolError);
  EXPECT_THROW(read_challenge(with_body(Kind::challenge, "")), ProtocolError);
  EXPECT_THROW(read_hello(with_body(Kind::hello, "GET / HTTP/1.1")), ProtocolError);
  Hello other;
  other.version = 9;
  try {
    read_hello(incoming(write_hello(other)));
    FAIL();
  } catch (const ProtocolError& e) {
    EXPECT_THAT(e.what(), HasSubstr("version 9"));
  }
}

TEST(RobotProtocol, proves_a_token_by_both_nonces_and_the_side) {
  const Nonce a = random_nonce(), b = random_nonce();
  EXPECT_NE(a, b);
  const Proof proof = make_proof(Side::agent, "token", a, b);
  EXPECT_TRUE(same_proof(proof, make_proof(Side::agent, "token", a, b)));
  EXPECT_FALSE(same_proof(proof, make_proof(Side::driver, "token", a, b)));
  EXPECT_FALSE(same_proof(proof, make_proof(Side::agent, "tokem", a, b)));
  EXPECT_FALSE(same_proof(proof, make_proof(Side::agent, "token", b, a)));
  EXPECT_FALSE(same_proof(proof, make_proof(Side::agent, {}, a, b)));
}

TEST(RobotAddress, needs_a_token_where_others_can_reach_it) {
  for (const char* address : {"127.0.0.1:1", "127.9.9.9:0", "[::1]:7411", "localhost:7411"}) {
    EXPECT_TRUE(is_loopback(address)) << address;
    EXPECT_NO_THROW(check_token(address, "", "token")) << address;
    EXPECT_THROW(check_token(address, "short", "token"), std::invalid_argument) << address;
  }
  for (const char* address : {"0.0.0.0:1", "[::]:1", "192.168.1.7:7411", "gateway.lan:7411", "128.0.0.1:1"}) {
    EXPECT_FALSE(is_loopback(address)) << address;
    EXPECT_THROW(check_token(address, "", "token"), std::invalid_argument) << address;
    EXPECT_THROW(check_token(address, "fifteen chars..", "token"), std::invalid_argument) << address;
    EXPECT_NO_THROW(check_token(address, "sixteen chars...", "token")) << address;
  }
  for (const char* address : {"", "7411", "host:", ":7411"})
    EXPECT_THROW(split_address(address), std::invalid_argument);
  for (const char* address : {"gateway:1", "127.0.0.1:x", "127.0.0.1:70000", "1.2.3:4"}) {
    EXPECT_THROW(listen_at(address), std::invalid_argument) << address;
  }
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::robot
