#include <chrono>
#include <string>

#include <gtest/gtest.h>

#include <iotcloud/drivers/testing/mock_host.h>

using namespace iotcloud::drivers;
using namespace std::chrono_literals;
using iotcloud::drivers::testing::MockInstance;

extern "C" const Descriptor* iotcloud_driver_descriptor();  // what IOTCLOUD_DRIVER in thermometer.cc exports

TEST(Thermometer, sends_a_reading_in_every_period) {
  MockInstance meter(*iotcloud_driver_descriptor(), {{"period_ms", "100"}});
  ASSERT_TRUE(meter.start()) << meter.error();
  meter.host().advance(1s);  // nothing sleeps: time is simulated
  EXPECT_EQ(meter.host().published("reading").size(), 10u);
}

TEST(Thermometer, keeps_a_reading_that_the_channel_has_no_room_for) {
  MockInstance meter(*iotcloud_driver_descriptor());
  ASSERT_TRUE(meter.start()) << meter.error();
  meter.host().answer_publish("reading", PublishStatus::would_block);
  meter.host().advance(1s);
  meter.host().answer_publish("reading", PublishStatus::accepted);
  meter.host().advance(20ms);
  ASSERT_EQ(meter.host().published("reading").size(), 1u);
  EXPECT_EQ(meter.host().published("reading")[0].message.payload.text(), "15");
}

TEST(Thermometer, refuses_a_property_that_it_does_not_know) {
  MockInstance meter(*iotcloud_driver_descriptor(), {{"perriod_ms", "100"}});
  EXPECT_FALSE(meter.start());
  EXPECT_NE(meter.error().find("perriod_ms"), std::string::npos) << meter.error();
}
