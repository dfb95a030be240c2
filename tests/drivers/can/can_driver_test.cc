// The driver without a bus: below it is a socket that carries the kernel's frames, and the test is the bus.
#include <chrono>
#include <cstring>
#include <string>

#include <gmock/gmock.h>
#include <linux/can.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/can/can_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>

namespace iotcloud::drivers::can {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::MockInstance;

class CanTest : public ::testing::Test {
 protected:
  struct OnTest : CanDriver {
    OnTest() : CanDriver([](const Socket& wanted) { return plug(wanted); }) {}
  };
  static int plug(const CanDriver::Socket& wanted) {
    wanted_ = wanted;
    if (down_) throw std::runtime_error("the interface is down");
    std::array<int, 2> ends{};
    EXPECT_EQ(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, ends.data()), 0);
    unplug();
    bus_ = ends[0];
    return ends[1];
  }
  static void unplug() {
    if (bus_ >= 0) ::close(bus_);
    bus_ = -1;
  }
  void SetUp() override { down_ = false; }
  ~CanTest() override { unplug(); }

  static Descriptor plugin() { return describe<OnTest>("can", "test"); }
  static void put(std::uint32_t id, const std::string& data, bool fd = false) {
    canfd_frame frame{};
    frame.can_id = id;
    frame.len = static_cast<std::uint8_t>(data.size());
    std::memcpy(frame.data, data.data(), data.size());
    const std::size_t size = fd ? CANFD_MTU : CAN_MTU;
    EXPECT_EQ(::write(bus_, &frame, size), static_cast<ssize_t>(size));
  }
  /// "id length data size" of the next frame on the bus.
  static std::string take() {
    canfd_frame frame{};
    const ssize_t size = ::read(bus_, &frame, sizeof frame);
    return size < 0
               ? "none"
               : std::to_string(frame.can_id) + " " +
                     std::string(reinterpret_cast<const char*>(frame.data), frame.len) + " " + std::to_string(size);
  }
  static Message frame(const std::string& data, const PropertyMap& properties) {
    Message message = command(data);
    for (const auto& [name, value] : properties) message.properties.set(name, value);
    return message;
  }

  static inline CanDriver::Socket wanted_;
  static inline bool down_ = false;
  static inline int bus_ = -1;
};

TEST_F(CanTest, makes_messages_of_frames_with_their_ids) {
  MockInstance bus(plugin(), {{"interface", "can0"}, {"filters", "123,18fef100:1fffff00"}, {"fd", "true"}});
  ASSERT_TRUE(bus.start()) << bus.error();
  EXPECT_EQ(wanted_.interface, "can0");
  EXPECT_EQ(wanted_.filters, (std::vector<Filter>{{0x123, 0x7ff, false}, {0x18fef100, 0x1fffff00, true}}));
  put(0x7, "speed");
  put(0x18fef100 | CAN_EFF_FLAG, "");
  put(0x123 | CAN_RTR_FLAG, "");
  put(0x123, std::string(64, 'x'), true);
  put(CAN_ERR_FLAG | 4, "");
  ASSERT_TRUE(until_published(bus, "received", 4));
  EXPECT_THAT(texts(bus, "received"), ElementsAre("speed", "", "", std::string(64, 'x')));
  std::vector<std::string> properties;
  for (const auto& published : bus.host().published("received")) {
    std::string all;
    for (const auto& [name, value] : published.message.properties) all += name + "=" + value + " ";
    properties.push_back(all);
  }
  EXPECT_THAT(properties,
              ElementsAre("id=007 ", "id=18fef100 extended=true ", "id=123 remote=true ", "id=123 fd=true "));
  EXPECT_TRUE(until(bus, [&] { return bus.host().logged_count("the bus reports an error") == 1; }));
}

TEST_F(CanTest, sends_frames_and_says_which_it_cannot) {
  MockInstance bus(plugin(), {{"interface", "can0"}, {"send_id", "7ff"}});
  ASSERT_TRUE(bus.start()) << bus.error();
  ASSERT_TRUE(bus.deliver("send", command("12345678")));
  EXPECT_EQ(take(), "2047 12345678 16");
  ASSERT_TRUE(bus.deliver("send", frame("", {{"id", "00000001"}, {"remote", "true"}})));
  EXPECT_EQ(take(), std::to_string(1 | CAN_EFF_FLAG | CAN_RTR_FLAG) + "  16");
  for (const char* id : {"800", "", "12g", "20000000", "-1"})
    ASSERT_TRUE(bus.deliver("send", frame("x", {{"id", id}})));
  ASSERT_TRUE(bus.deliver("send", command("123456789")));
  EXPECT_EQ(take(), "none");
  EXPECT_EQ(bus.host().logged_count("\"800\" is no id"), 1U);
  MockInstance fast(plugin(), {{"interface", "can0"}, {"send_id", "1"}, {"fd", "true"}});
  ASSERT_TRUE(fast.start()) << fast.error();
  ASSERT_TRUE(fast.deliver("send", command("123456789")));
  EXPECT_EQ(take(), "1 123456789 72");
}

TEST_F(CanTest, reads_no_further_while_its_channel_is_full) {
  MockInstance bus(plugin(), {{"interface", "can0"}});
  ASSERT_TRUE(bus.start()) << bus.error();
  bus.host().answer_publish("received", PublishStatus::would_block);
  put(1, "a");
  put(2, "b");
  ASSERT_GT(bus.host().poll_descriptors(60s), 0U);
  EXPECT_EQ(bus.host().poll_descriptors(0ms), 0U);
  bus.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(bus.writable("received"));
  ASSERT_TRUE(until_published(bus, "received", 2));
  EXPECT_THAT(texts(bus, "received"), ElementsAre("a", "b"));
}

TEST_F(CanTest, finds_an_interface_again_that_was_gone) {
  down_ = true;
  MockInstance bus(plugin(), {{"interface", "can0"}});
  ASSERT_TRUE(bus.start()) << bus.error();
  EXPECT_EQ(bus.host().metadata()["connection_problem"], "the interface is down");
  ASSERT_TRUE(bus.deliver("send", frame("x", {{"id", "1"}})));
  EXPECT_EQ(bus.host().logged_count("the bus is away"), 1U);
  down_ = false;
  bus.host().advance(500ms);
  EXPECT_EQ(bus.host().metadata()["connection"], "connected");
  unplug();
  ASSERT_TRUE(until_metadata(bus, "connection", "away"));
  bus.host().advance(1s);
  put(1, "back");
  ASSERT_TRUE(until_published(bus, "received", 1));
}

TEST_F(CanTest, says_what_is_wrong) {
  const auto error_with = [](PropertyMap properties) {
    properties.try_emplace("interface", "can0");
    MockInstance instance(plugin(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({{"filters", "800"}}), HasSubstr("ID:MASK"));
  EXPECT_THAT(error_with({{"filters", "1:x"}}), HasSubstr("mask"));
  EXPECT_THAT(error_with({{"send_id", "zz"}}), HasSubstr("\"send_id\""));
  EXPECT_THROW(CanDriver::open_socket({"no-such-can", {}, false}), std::runtime_error);
}

}  // namespace
}  // namespace iotcloud::drivers::can
