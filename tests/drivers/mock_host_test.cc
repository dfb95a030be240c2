#include <array>
#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <unistd.h>

#include <iotcloud/drivers/testing/mock_host.h>

namespace iotcloud::drivers::testing {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Does what the test says.
struct ToyDriver : Driver {
  std::vector<ChannelSpec> channels(const PropertyMap& properties) override {
    if (properties.contains("bad")) throw std::invalid_argument("bad property");
    ChannelSpec spec;
    spec.name = "out";
    ChannelSpec other = spec, in = spec;
    other.name = "other";
    in.name = "in";
    in.direction = Direction::in;
    return {spec, other, in};
  }
  void open(DriverContext& given) override {
    context = &given;
    if (on_open) on_open(given);
  }
  void close() override { closed = true; }
  void on_message(std::string_view channel, Message message) override {
    if (message.payload.text() == "throw") throw std::runtime_error("cannot do that");
    if (message.payload.text() == "throw a number") throw 7;  // NOLINT: as a careless author may do
    last = std::string(channel) + ":" + std::string(message.payload.text());
  }
  void on_writable(std::string_view channel) override { last = "writable:" + std::string(channel); }
  void on_stored(std::string_view channel, std::uint64_t count) override {
    last = "stored:" + std::string(channel) + ":" + std::to_string(count);
  }
  static inline std::function<void(DriverContext&)> on_open;
  static inline DriverContext* context = nullptr;
  static inline std::string last;
  static inline bool closed = false;
};

class MockHostTest : public ::testing::Test {
 protected:
  MockHostTest() {
    ToyDriver::on_open = nullptr;
    ToyDriver::last.clear();
    ToyDriver::closed = false;
  }
  Message text(const std::string& bytes) {
    Message message;
    message.payload = Payload::copy(bytes);
    return message;
  }
  Descriptor toy = describe<ToyDriver>("toy", "1");
};

TEST_F(MockHostTest, runs_timers_in_the_order_of_their_intended_times) {
  MockInstance instance(toy);
  std::vector<std::string> calls;
  ToyDriver::on_open = [&](DriverContext& context) {
    context.every(30ms, [&] { calls.push_back("30ms at " + std::to_string(instance.host().now() / 1ms)); });
    context.after(50ms, [&] { calls.push_back("once at " + std::to_string(instance.host().now() / 1ms)); });
  };
  ASSERT_TRUE(instance.start());
  instance.host().advance(20ms);
  EXPECT_TRUE(calls.empty());
  instance.host().advance(80ms);
  EXPECT_THAT(calls, ElementsAre("30ms at 30", "once at 50", "30ms at 60", "30ms at 90"));
  EXPECT_EQ(instance.host().now(), 100ms);
}

TEST_F(MockHostTest, lets_a_timer_stop_itself_and_others) {
  MockInstance instance(toy);
  int calls = 0;
  ToyDriver::on_open = [&](DriverContext& context) {
    auto id = std::make_shared<HandlerId>();
    *id = context.every(10ms, [&calls, &context, id] {
      if (++calls == 2) context.stop(*id);
    });
    context.stop(context.after(5ms, [&] { calls = 100; }));
  };
  ASSERT_TRUE(instance.start());
  instance.host().advance(1s);
  EXPECT_EQ(calls, 2);
}

TEST_F(MockHostTest, records_what_is_published_with_the_metadata_a_host_fills_in) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  instance.host().advance(5ms);
  EXPECT_EQ(ToyDriver::context->publish("out", Payload::copy("a")), PublishStatus::accepted);
  instance.host().answer_publish("out", PublishStatus::would_block);
  EXPECT_EQ(ToyDriver::context->publish("out", Payload::copy("b")), PublishStatus::would_block);
  EXPECT_EQ(ToyDriver::context->publish("other", Payload::copy("c")), PublishStatus::accepted);
  const auto published = instance.host().published("out");
  ASSERT_EQ(published.size(), 1);
  EXPECT_EQ(published[0].message.payload.text(), "a");
  EXPECT_EQ(published[0].message.driver_id, instance.host().instance_id());
  EXPECT_EQ(published[0].message.gateway_id, instance.host().gateway_id());
  EXPECT_GT(published[0].message.time_ms, 0);
  EXPECT_EQ(instance.host().published().size(), 2);
}

TEST_F(MockHostTest, hands_messages_over_and_keeps_the_first_exception) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  EXPECT_TRUE(instance.deliver("in", text("hello")));
  EXPECT_EQ(ToyDriver::last, "in:hello");
  EXPECT_TRUE(instance.writable("out"));
  EXPECT_EQ(ToyDriver::last, "writable:out");
  EXPECT_TRUE(instance.stored("out", 7));
  EXPECT_EQ(ToyDriver::last, "stored:out:7");
  EXPECT_FALSE(instance.deliver("in", text("throw")));
  EXPECT_FALSE(instance.deliver("in", text("throw a number")));
  EXPECT_EQ(instance.error(), "cannot do that");
  instance.close();
  EXPECT_TRUE(ToyDriver::closed);
}

TEST_F(MockHostTest, fails_an_instance_that_publishes_on_a_channel_that_it_has_not_declared) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  EXPECT_EQ(ToyDriver::context->publish("uot", Payload::copy("a")), PublishStatus::closed);
  EXPECT_TRUE(instance.host().failed());
  EXPECT_EQ(instance.host().failure(), "there is no outgoing channel \"uot\"; channels() declares \"out\", \"other\"");
  EXPECT_TRUE(instance.host().published().empty());
}

TEST_F(MockHostTest, delivers_on_declared_channels_only) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  EXPECT_THROW(instance.deliver("on", text("hello")), std::invalid_argument);
  EXPECT_THROW(instance.deliver("out", text("hello")), std::invalid_argument);
  EXPECT_THROW(instance.writable("in"), std::invalid_argument);
  EXPECT_THROW(instance.stored("oute", 1), std::invalid_argument);
  EXPECT_EQ(ToyDriver::last, "");
}

TEST_F(MockHostTest, does_not_open_what_refuses_its_properties) {
  MockInstance instance(toy, {{"bad", "1"}});
  EXPECT_FALSE(instance.start());
  EXPECT_EQ(instance.error(), "bad property");
  instance.close();
  EXPECT_FALSE(ToyDriver::closed);
}

TEST_F(MockHostTest, sees_an_exception_in_a_callback_as_the_instance_s_failure) {
  MockInstance instance(toy);
  ToyDriver::on_open = [](DriverContext& context) {
    context.after(1ms, [] { throw std::runtime_error("the device is gone"); });
    context.after(2ms, [] { throw 7; });
  };
  ASSERT_TRUE(instance.start());
  EXPECT_FALSE(instance.host().failed());
  instance.host().advance(1s);
  EXPECT_TRUE(instance.host().failed());
  EXPECT_EQ(instance.host().failure(), "the device is gone");
}

TEST_F(MockHostTest, takes_posts_from_other_threads) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  const auto test_thread = std::this_thread::get_id();
  std::thread::id ran_on;
  std::thread([&] { ToyDriver::context->post([&] { ran_on = std::this_thread::get_id(); }); }).join();
  EXPECT_EQ(ran_on, std::thread::id());
  EXPECT_EQ(instance.host().run_posted(), 1);
  EXPECT_EQ(ran_on, test_thread);
}

TEST_F(MockHostTest, keeps_the_metadata_that_the_driver_says) {
  MockInstance instance(toy);
  ASSERT_TRUE(instance.start());
  ToyDriver::context->update_metadata({{"battery", "90"}, {"site", "lab"}});
  ToyDriver::context->update_metadata({{"battery", "80"}, {"site", ""}});
  EXPECT_EQ(instance.host().metadata(), (PropertyMap{{"battery", "80"}}));
}

TEST_F(MockHostTest, watches_descriptors) {
  std::array<int, 2> ends{};
  ASSERT_EQ(pipe(ends.data()), 0);
  MockInstance instance(toy);
  int readable = 0;
  ToyDriver::on_open = [&](DriverContext& context) { context.on_readable(ends[0], [&] { ++readable; }); };
  ASSERT_TRUE(instance.start());
  EXPECT_EQ(instance.host().poll_descriptors(0ms), 0);
  ASSERT_EQ(write(ends[1], "x", 1), 1);
  EXPECT_EQ(instance.host().poll_descriptors(1s), 1);
  EXPECT_EQ(readable, 1);
  ::close(ends[0]);
  ::close(ends[1]);
}

TEST_F(MockHostTest, calls_nothing_after_close) {
  MockInstance instance(toy);
  int calls = 0;
  ToyDriver::on_open = [&](DriverContext& context) { context.every(1ms, [&] { ++calls; }); };
  ASSERT_TRUE(instance.start());
  ToyDriver::context->post([&] { ++calls; });
  instance.close();
  instance.host().advance(1s);
  EXPECT_EQ(calls, 0);
}

}  // namespace
}  // namespace iotcloud::drivers::testing
