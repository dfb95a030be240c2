#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>

namespace iotcloud::drivers::turtle {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::MockInstance;
using ::testing::Not;

/// A device that sends one encoded frame.
class Postcard final : public DepthSource, public Actuator {
 public:
  Postcard(DriverContext& context, std::string text) : context_(context), text_(std::move(text)) {}
  void start(std::function<void(const DepthFrame&)> on_frame) override {
    context_.post([this, on_frame = std::move(on_frame)] {
      on_frame({std::nullopt, {}, 0, false, nullptr, Payload::copy(text_)});
    });
  }
  void stop() override {}
  void drive(const Velocity& velocity) override { context_.log(LogLevel::info, std::to_string(velocity.linear)); }
  void halt() override {}

 private:
  DriverContext& context_;
  const std::string text_;
};

DeviceKind postcard_kind() {
  DeviceKind kind;
  kind.name = "postcard";
  kind.source = kind.actuator = true;
  kind.read = [](PropertyReader& reader, const TurtleOptions&, DeviceParts parts) -> DeviceMaker {
    const std::string text = reader.text("text", "hello");
    return [=](DriverContext& context) {
      context.log(LogLevel::info, std::string(parts.source ? "source" : "") + (parts.actuator ? " actuator" : ""));
      const auto both = std::make_shared<Postcard>(context, text);
      return Device{both, both};
    };
  };
  return kind;
}

/// A plugin with additional kinds.
struct Extended : TurtleDriver {
  static constexpr auto declared_properties = with_kind("postcard", std::array{PropertySpec{.name = "text"}});
  Extended() : TurtleDriver(shipped_kinds().with(postcard_kind())) {}
};

const Descriptor shipped = describe<TurtleDriver>("turtle", "test", true);
const Descriptor extended = describe<Extended>("turtle", "test", true);

std::string error_with(const Descriptor& driver, const PropertyMap& properties) {
  MockInstance robot(driver, properties);
  EXPECT_FALSE(robot.open());
  return robot.error();
}

TEST(DeviceKinds, of_a_plugin_s_own_stand_beside_the_shipped_ones) {
  EXPECT_THAT(error_with(shipped, {{"source", "postcard"}}), AllOf(HasSubstr("\"source\""), HasSubstr("simulator")));
  MockInstance robot(extended, {{"source", "postcard"}, {"text", "from afar"}});
  ASSERT_TRUE(robot.start()) << robot.error();
  EXPECT_EQ(robot.host().logged_count("source actuator"), 1);  // one device for both
  robot.host().advance(1ms);
  const auto frames = robot.host().published("kinect");
  ASSERT_EQ(frames.size(), 1);
  EXPECT_EQ(frames[0].message.payload.text(), "from afar");  // unchanged
  Message command;
  command.payload = Payload::copy(std::string_view(R"({"linear":{"x":0.25},"angular":{"z":0}})"));
  ASSERT_TRUE(robot.deliver("control", command));
  EXPECT_EQ(robot.host().logged_count("0.25"), 1);
}

TEST(DeviceKinds, have_properties_of_their_own_which_nobody_else_takes) {
  const std::string of_simulator = error_with(extended, {{"text", "x"}});
  EXPECT_THAT(of_simulator, AllOf(HasSubstr("\"text\""), HasSubstr("seed"), HasSubstr("watchdog_ms")));
  const std::string of_postcard = error_with(extended, {{"source", "postcard"}, {"seed", "1"}});
  EXPECT_THAT(of_postcard, AllOf(HasSubstr("\"seed\""), HasSubstr("text"), Not(HasSubstr("retry_ms"))));
}

TEST(DeviceKinds, are_paired_where_that_makes_sense) {
  const std::string simulated_base = error_with(extended, {{"source", "postcard"}, {"actuator", "simulator"}});
  EXPECT_THAT(simulated_base, AllOf(HasSubstr("actuator"), HasSubstr("simulator"), HasSubstr("postcard")));
  EXPECT_THAT(error_with(extended, {{"source", "none"}}), HasSubstr("source"));  // an actuator only

  MockInstance frames_only(extended, {{"source", "simulator"}, {"actuator", "none"}, {"seed", "2"}});
  ASSERT_TRUE(frames_only.start()) << frames_only.error();
  frames_only.host().advance(100ms);
  EXPECT_EQ(frames_only.host().published("kinect").size(), 3);

  MockInstance mixed(extended, {{"source", "simulator"}, {"actuator", "postcard"}});
  ASSERT_TRUE(mixed.start()) << mixed.error();
  EXPECT_EQ(mixed.host().logged_count(" actuator"), 1);
  EXPECT_EQ(mixed.host().logged_count("source"), 0);
}

}  // namespace
}  // namespace iotcloud::drivers::turtle
