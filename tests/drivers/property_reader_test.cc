#include <stdexcept>

#include <gmock/gmock.h>

#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

template <typename Call>
std::string message_of(Call&& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(PropertyReader, reads_values_and_falls_back) {
  const PropertyMap properties{{"name", "x"}, {"speed", "-2.5e-1"}, {"count", "12"}, {"on", "true"}};
  PropertyReader reader(properties);
  EXPECT_EQ(reader.text("name", "y"), "x");
  EXPECT_EQ(reader.text("other", "y"), "y");
  EXPECT_DOUBLE_EQ(reader.number("speed", 1, -1, 1), -0.25);
  EXPECT_DOUBLE_EQ(reader.number("weight", 1, -1, 1), 1);
  EXPECT_EQ(reader.integer("count", 3, 0, 12), 12);
  EXPECT_TRUE(reader.flag("on", false));
  EXPECT_FALSE(reader.flag("off", false));
  EXPECT_NO_THROW(reader.finish());
}

TEST(PropertyReader, takes_a_list_apart) {
  EXPECT_THAT(words_of(" a , b c,,\td\n, "), ::testing::ElementsAre("a", "b c", "d"));
  EXPECT_THAT(words_of("a:b", ':'), ::testing::ElementsAre("a", "b"));
  EXPECT_THAT(words_of(" "), ::testing::IsEmpty());
}

TEST(PropertyReader, refuses_what_is_no_number_or_out_of_range) {
  for (const std::string value : {"", "1x", " 1", "0x10", "nan", "inf", "1e999", "11", "-1"}) {
    const PropertyMap properties{{"speed", value}};
    EXPECT_THAT(message_of([&] { PropertyReader(properties).number("speed", 1, 0, 10); }),
                AllOf(HasSubstr("\"speed\""), HasSubstr("\"" + value + "\""), HasSubstr("from 0 to 10")));
    EXPECT_THAT(message_of([&] { PropertyReader(properties).integer("speed", 1, 0, 10); }), HasSubstr("whole number"));
  }
  const PropertyMap half{{"count", "1.5"}};
  EXPECT_THAT(message_of([&] { PropertyReader(half).integer("count", 1, 0, 10); }), HasSubstr("whole number"));
}

TEST(PropertyReader, lists_the_choices) {
  const PropertyMap properties{{"color", "mauve"}};
  EXPECT_THAT(message_of([&] {
                PropertyReader(properties).choice("color", "red", {"red", "blue"});
              }),
              AllOf(HasSubstr("mauve"), HasSubstr("red, blue")));
}

TEST(PropertyReader, refuses_unknown_properties_but_the_host_s) {
  const PropertyMap properties{{"speed", "1"},           {"sped", "2"},        {"channel.out.capacity", "3"},
                               {"thread", "own"},        {"hang_limit", "3s"}, {"isolation", "instance"},
                               {"on_partition", "stop"}, {"lease", "30s"},     {"network", "camera-1:554"}};
  PropertyReader reader(properties);
  reader.number("speed", 1, 0, 10);
  EXPECT_THAT(message_of([&] { reader.finish(); }), AllOf(HasSubstr("\"sped\""), HasSubstr("knows: speed")));
  reader.number("sped", 1, 0, 10);
  EXPECT_NO_THROW(reader.finish());
}

}  // namespace
}  // namespace iotcloud::drivers
