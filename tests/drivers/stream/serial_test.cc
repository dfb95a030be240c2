#include <chrono>
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <termios.h>

#include <iotcloud/drivers/serial/serial_driver.h>
#include <iotcloud/tests/drivers/stream/line.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::serial {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

Descriptor serial() {
  return describe<SerialDriver>("serial", "test");
}

TEST(Serial, carries_frames_both_ways_on_a_line_as_it_was_set) {
  Line line;
  testing::MockInstance scale(serial(),
                              {{"device", line.path()}, {"baud", "9600"}, {"stop_bits", "2"}, {"delimiter", "\\r\\n"}});
  ASSERT_TRUE(scale.start()) << scale.error();
  EXPECT_EQ(scale.host().metadata()["connection"], "connected");
  const termios set = line.settings();
  EXPECT_EQ(cfgetospeed(&set), speed_t{B9600});
  EXPECT_EQ(set.c_cflag & CSTOPB,
            tcflag_t{CSTOPB});  // the kernel's terminals have 8 bits and no parity, whatever one sets
  EXPECT_EQ(set.c_lflag & (ICANON | ECHO), tcflag_t{0});
  line.write("12.5 kg\r\n12.");
  line.write("6 kg\r\n");
  ASSERT_TRUE(until_published(scale, "received", 2));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("12.5 kg", "12.6 kg"));
  ASSERT_TRUE(scale.deliver("send", command("tare")));
  EXPECT_EQ(line.read(6), "tare\r\n");
}

struct FramingCase {
  const char* name;
  PropertyMap properties;
  std::string frame;  ///< of "a\0b" as it is on the line
};

class SerialFramings : public ::testing::TestWithParam<FramingCase> {};

TEST_P(SerialFramings, carry_bytes_of_any_value_both_ways) {
  const auto& [name, properties, frame] = GetParam();
  Line line;
  PropertyMap all = properties;
  all["device"] = line.path();
  testing::MockInstance scale(serial(), all);
  ASSERT_TRUE(scale.start()) << scale.error();
  const std::string bytes("a\0b", 3);
  line.write(frame.substr(0, 2));
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);
  line.write(frame.substr(2) + frame);
  ASSERT_TRUE(until_published(scale, "received", 2));
  EXPECT_THAT(texts(scale, "received"), ElementsAre(bytes, bytes));
  ASSERT_TRUE(scale.deliver("send", command(bytes)));
  EXPECT_EQ(line.read(frame.size()), frame);
}

INSTANTIATE_TEST_SUITE_P(
    Of, SerialFramings,
    ::testing::Values(FramingCase{"delimiter", {{"framing", "delimiter"}, {"delimiter", ";"}}, std::string("a\0b;", 4)},
                      FramingCase{"length", {{"framing", "length"}, {"length_bytes", "2"}}, std::string("\0\3a\0b", 5)},
                      FramingCase{"cobs", {{"framing", "cobs"}}, std::string("\2a\2b\0", 5)},
                      FramingCase{"slip", {{"framing", "slip"}}, std::string("\300a\0b\300", 5)}),
    [](const auto& of) { return std::string(of.param.name); });

TEST(Serial, finds_a_device_again_that_was_unplugged) {
  tests::TemporaryFolder folder;
  const std::string link = folder / "scale";
  testing::MockInstance scale(serial(), {{"device", link}, {"reconnect_ms", "100"}});
  ASSERT_TRUE(scale.start()) << scale.error();
  EXPECT_EQ(scale.host().metadata()["connection"], "away");
  EXPECT_THAT(scale.host().metadata()["connection_problem"], HasSubstr("No such file"));
  Line first, second;
  std::filesystem::create_symlink(first.path(), link);
  scale.host().advance(100ms);
  ASSERT_EQ(scale.host().metadata()["connection"], "connected");
  EXPECT_EQ(scale.host().metadata().count("connection_problem"), 0U);
  first.unplug();
  ASSERT_TRUE(until_metadata(scale, "connection", "away"));
  ASSERT_TRUE(scale.deliver("send", command("lost")));
  EXPECT_EQ(scale.host().logged_count("the device is away (while_away is drop)"), 1U);
  std::filesystem::remove(link);
  std::filesystem::create_symlink(second.path(), link);
  scale.host().advance(100ms);  // the second pause is twice the first
  EXPECT_EQ(scale.host().metadata()["connection"], "away");
  scale.host().advance(100ms);
  ASSERT_EQ(scale.host().metadata()["connection"], "connected");
  second.write("back\n");
  ASSERT_TRUE(until_published(scale, "received", 1));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("back"));
}

TEST(Serial, reads_no_further_while_its_channel_is_full) {
  Line line;
  testing::MockInstance scale(serial(), {{"device", line.path()}});
  ASSERT_TRUE(scale.start()) << scale.error();
  scale.host().answer_publish("received", PublishStatus::would_block);
  line.write("1\n2\n");
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);
  line.write("3\n");
  EXPECT_EQ(scale.host().poll_descriptors(0ms), 0U);  // nobody reads
  scale.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(scale.writable("received"));
  ASSERT_TRUE(until_published(scale, "received", 3));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("1", "2", "3"));
}

TEST(Serial, forgets_a_frame_whose_end_does_not_come) {
  Line line;
  testing::MockInstance scale(serial(), {{"device", line.path()}, {"framing", "length"}, {"frame_limit_ms", "50"}});
  ASSERT_TRUE(scale.start()) << scale.error();
  line.write(std::string("\0\5no", 4));
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);
  scale.host().advance(50ms);
  line.write(std::string("\0\3yes", 5));
  ASSERT_TRUE(until_published(scale, "received", 1));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("yes"));
}

TEST(Serial, keeps_whole_frames_that_wait_for_its_channel_whatever_the_frame_limit_is) {
  Line line;
  testing::MockInstance scale(serial(), {{"device", line.path()}, {"framing", "length"}, {"frame_limit_ms", "50"}});
  ASSERT_TRUE(scale.start()) << scale.error();
  line.write(std::string("\0\5on", 4));
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);  // its end is waited for
  scale.host().answer_publish("received", PublishStatus::would_block);
  line.write(std::string("e! \0\3two\0\5th", 12));
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);
  scale.host().advance(50ms);
  scale.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(scale.writable("received"));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("one! ", "two"));
  scale.host().advance(50ms);  // the third one's end has not come
  line.write(std::string("\0\4four", 6));
  ASSERT_TRUE(until_published(scale, "received", 3));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("one! ", "two", "four"));
}

TEST(Serial, drops_frames_while_it_is_inactive) {
  Line line;
  testing::MockInstance scale(serial(), {{"device", line.path()}});
  ASSERT_TRUE(scale.open()) << scale.error();
  line.write("early\n");
  ASSERT_GT(scale.host().poll_descriptors(60s), 0U);
  ASSERT_TRUE(scale.activate());
  line.write("now\n");
  ASSERT_TRUE(until_published(scale, "received", 1));
  EXPECT_THAT(texts(scale, "received"), ElementsAre("now"));
}

TEST(Serial, leaves_a_line_alone_that_another_instance_has) {
  Line line;
  testing::MockInstance first(serial(), {{"device", line.path()}}), second(serial(), {{"device", line.path()}});
  ASSERT_TRUE(first.start()) << first.error();
  ASSERT_TRUE(second.start()) << second.error();
  EXPECT_THAT(second.host().metadata()["connection_problem"], HasSubstr("in use"));
}

TEST(Serial, says_which_property_is_wrong) {
  const auto error_with = [](const PropertyMap& properties) {
    testing::MockInstance instance(serial(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({}), HasSubstr("device"));
  EXPECT_THAT(error_with({{"device", "x"}, {"baud", "9601"}}), HasSubstr("9601"));
  EXPECT_THAT(error_with({{"device", "x"}, {"delimeter", ";"}}), HasSubstr("did you mean \"delimiter\"?"));
  EXPECT_THAT(error_with({{"device", "x"}, {"reconnect_ms", "900"}, {"reconnect_most_ms", "100"}}),
              HasSubstr("at least reconnect_ms"));
  testing::MockInstance file(serial(), {{"device", "/dev/null"}});
  ASSERT_TRUE(file.start());
  EXPECT_THAT(file.host().metadata()["connection_problem"], HasSubstr("no serial line"));
}

}  // namespace
}  // namespace iotcloud::drivers::serial
