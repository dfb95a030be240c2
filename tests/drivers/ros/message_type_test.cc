#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/ros/message_type.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::ros {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::size_t plenty = 1 << 20;

// As ROS' own message generator hashes and joins them.
const std::string separator(80, '=');
const std::string vector3 = "float64 x\nfloat64 y\nfloat64 z\n";
const std::string twist =
    "# A velocity\nVector3  linear\nVector3  angular\n" + separator + "\nMSG: geometry_msgs/Vector3\n" + vector3;
const std::string status =
    "int8 STATUS_NO_FIX =  -1        # unable to fix position\nint8 STATUS_FIX =      0\nint8 STATUS_SBAS_FIX = 1\n"
    "int8 STATUS_GBAS_FIX = 2\nint8 status\nuint16 SERVICE_GPS =     1\nuint16 SERVICE_GLONASS = 2\n"
    "uint16 SERVICE_COMPASS = 4\nuint16 SERVICE_GALILEO = 8\nuint16 service\n";

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

template <typename Number>
std::string raw(Number number) {
  std::string bytes(sizeof number, '\0');
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}

std::string json_of(const std::string& definition, const std::string& bytes, std::size_t most = plenty) {
  return MessageType::parse("a/B", definition).to_json(bytes_of(bytes), most);
}

template <typename Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const DefinitionError& e) {
    return e.what();
  } catch (const FormatError& e) {
    return e.what();
  }
  ADD_FAILURE() << "nothing was refused";
  return "";
}

std::string definition_refusal(const std::string& text, const std::string& name = "a/B") {
  return refusal([&] { MessageType::parse(name, text); });
}

TEST(RosMessageType, has_the_md5sum_that_ros_computes) {
  EXPECT_EQ(MessageType::parse("geometry_msgs/Twist", twist).checksum(), "9f195f881246fdfa2798d1d3eebca84a");
  EXPECT_EQ(MessageType::parse("std_msgs/String", "string data\n").checksum(), "992ce8a1687cec8c8bd883ec73ca41d1");
  EXPECT_EQ(MessageType::parse("std_msgs/Empty", "").checksum(), "d41d8cd98f00b204e9800998ecf8427e");
  EXPECT_EQ(MessageType::parse("sensor_msgs/NavSatStatus", status).checksum(), "331cdbddfa4bc96ffc3b9ad98900a54c");
}

TEST(RosMessageType, reads_files_of_folders_and_joins_them_as_ros_does) {
  const tests::TemporaryFolder first, second;
  std::filesystem::create_directories(first / "geometry_msgs/msg");
  std::filesystem::create_directories(second / "my_msgs/msg");
  tests::write_file(first / "geometry_msgs/msg/Vector3.msg", vector3);
  tests::write_file(first / "geometry_msgs/msg/Twist.msg", "# A velocity\nVector3  linear\nVector3  angular\n");
  tests::write_file(second / "my_msgs/msg/Way.msg", "geometry_msgs/Twist[] steps\nWay2 next\n");
  tests::write_file(second / "my_msgs/msg/Way2.msg", "geometry_msgs/Vector3 to");
  const std::vector<std::string> folders{second / "my_msgs", first.path()};
  const MessageType read = MessageType::load("geometry_msgs/Twist", folders);
  EXPECT_EQ(read.checksum(), "9f195f881246fdfa2798d1d3eebca84a");
  EXPECT_EQ(MessageType::parse("geometry_msgs/Twist", read.definition()).checksum(), read.checksum());
  const MessageType way = MessageType::load("my_msgs/Way", folders);
  EXPECT_EQ(MessageType::parse("my_msgs/Way", way.definition()).checksum(), way.checksum());
  EXPECT_THAT(refusal([&] { MessageType::load("my_msgs/Other", folders); }),
              AllOf(HasSubstr("my_msgs/msg/Other.msg"), HasSubstr(first.path()), HasSubstr("msg_path")));
  EXPECT_THAT(refusal([&] { MessageType::load("Twist", folders); }), HasSubstr("geometry_msgs/Twist"));
  EXPECT_THAT(refusal([&] { MessageType::load("../../etc/Twist", folders); }), HasSubstr("no type"));
}

TEST(RosMessageType, writes_each_kind_of_field_as_json) {
  EXPECT_EQ(
      json_of("bool a\nint8 b\nuint8 c\nbyte d\nchar e\nint16 f\nuint16 g\nint32 h\nuint32 i\nint64 j\nuint64 k\n",
              raw(std::uint8_t{2}) + raw(std::int8_t{-1}) + raw(std::uint8_t{255}) + raw(std::int8_t{-2}) +
                  raw(std::uint8_t{65}) + raw(std::int16_t{-300}) + raw(std::uint16_t{60000}) + raw(-70000) +
                  raw(4'000'000'000u) + raw(std::numeric_limits<std::int64_t>::min()) +
                  raw(std::numeric_limits<std::uint64_t>::max())),
      R"({"a":true,"b":-1,"c":255,"d":-2,"e":65,"f":-300,"g":60000,"h":-70000,"i":4000000000,)"
      R"("j":-9223372036854775808,"k":18446744073709551615})");
  EXPECT_EQ(json_of("float32 a\nfloat64 b\nfloat64 c\nfloat32 d\ntime e\nduration f",
                    raw(0.1f) + raw(1e300) + raw(std::nan("")) + raw(std::numeric_limits<float>::infinity()) + raw(7u) +
                        raw(8u) + raw(-7) + raw(-8)),
            R"({"a":0.1,"b":1e+300,"c":null,"d":null,"e":{"secs":7,"nsecs":8},"f":{"secs":-7,"nsecs":-8}})");
  EXPECT_EQ(json_of("string a\nstring[] b", raw(5u) + "x\xff\"\n\x01" + raw(2u) + raw(1u) + "y" + raw(0u)),
            "{\"a\":\"x\xef\xbf\xbd\\\"\\n\\u0001\",\"b\":[\"y\",\"\"]}");
  EXPECT_EQ(json_of("uint8[] a\nuint8[3] b\nint8[2] c\nchar[] d\nuint16[] e",
                    raw(4u) + "\x01\x02\x03\x04" + "abc" + "\xff\x01" + raw(0u) + raw(1u) + raw(std::uint16_t{7})),
            R"({"a":"AQIDBA==","b":"YWJj","c":[-1,1],"d":"","e":[7]})");
}

TEST(RosMessageType, writes_messages_within_messages) {
  const std::string definition = "Header header\nb/Inner[] all\nInner2 own\nint32 CONSTANT=7\nstring TEXT= a # b\n" +
                                 separator + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n" +
                                 separator + "\nMSG: b/Inner\nuint8 x\n" + separator +
                                 "\nMSG: a/Inner2\nb/Inner[2] pair\n";
  EXPECT_EQ(json_of(definition, raw(1u) + raw(2u) + raw(3u) + raw(1u) + "f" + raw(2u) + "\x05\x06" + "\x07\x08"),
            R"({"header":{"seq":1,"stamp":{"secs":2,"nsecs":3},"frame_id":"f"},"all":[{"x":5},{"x":6}],)"
            R"("own":{"pair":[{"x":7},{"x":8}]}})");
}

TEST(RosMessageType, refuses_bytes_that_are_no_such_message) {
  EXPECT_THAT(refusal([] { json_of("int32 here", "123"); }), HasSubstr("within the field here"));
  EXPECT_THAT(refusal([] { json_of("int32 here", "12345"); }), HasSubstr("1 bytes too many"));
  EXPECT_THAT(refusal([] { json_of("string here", raw(~0u) + "x"); }), HasSubstr("within the field here"));
  EXPECT_THAT(refusal([] { json_of("float64[] here", raw(~0u)); }), HasSubstr("within the field here"));
  EXPECT_THAT(refusal([] { json_of("string here", raw(3000u) + std::string(3000, 'x'), 1000); }), HasSubstr("1000"));
  EXPECT_THAT(refusal([] { json_of("uint8[] here", raw(3000u) + std::string(3000, 'x'), 1000); }), HasSubstr("here"));
  // Four billion messages without a byte.
  EXPECT_THAT(refusal([] { json_of("Nothing[] here\n" + separator + "\nMSG: a/Nothing\n", raw(~0u)); }),
              HasSubstr("most_bytes"));
}

TEST(RosMessageType, refuses_hostile_definitions) {
  EXPECT_THAT(definition_refusal("int32"), HasSubstr("\"int32\""));
  EXPECT_THAT(definition_refusal("int32 a b"), HasSubstr("no field"));
  EXPECT_THAT(definition_refusal("int32 a-b"), HasSubstr("no field"));
  EXPECT_THAT(definition_refusal("int32 a\nint32 a"), HasSubstr("two fields a"));
  EXPECT_THAT(definition_refusal("int32[x] a"), HasSubstr("no array"));
  EXPECT_THAT(definition_refusal("int32[99999999999] a"), HasSubstr("no array"));
  EXPECT_THAT(definition_refusal("int32[ a"), HasSubstr("no array"));
  EXPECT_THAT(definition_refusal("int32[][] a"), HasSubstr("no array"));
  EXPECT_THAT(definition_refusal("vector x=1"), HasSubstr("no constant"));
  EXPECT_THAT(definition_refusal("Other a"), HasSubstr("lacks that of a/Other"));
  EXPECT_THAT(definition_refusal("../x/Other a"), HasSubstr("no type"));
  EXPECT_THAT(definition_refusal("B a"), HasSubstr("within itself"));
  EXPECT_THAT(definition_refusal("C a\n" + separator + "\nMSG: a/C\nB b"), HasSubstr("within itself"));
  EXPECT_THAT(definition_refusal("int32 a\n" + separator + "\nint32 b"), HasSubstr("MSG: TYPE"));
  EXPECT_THAT(definition_refusal("int32 a\n" + separator + "\nMSG: a b/c d"), HasSubstr("no type"));
  EXPECT_THAT(definition_refusal("int32 a", "B"), HasSubstr("no type"));
  EXPECT_THAT(definition_refusal(std::string((1 << 20) + 1, ' ')), HasSubstr("1 MiB"));
  EXPECT_EQ(definition_refusal("\x1b[31m a\n").find('\x1b'), std::string::npos);
  std::string many, types, deep;
  for (int i = 0; i <= 10'000; ++i) many += "int8 f" + std::to_string(i) + "\n";
  EXPECT_THAT(definition_refusal(many), HasSubstr("too many fields"));
  for (int i = 0; i <= 500; ++i) types += separator + "\nMSG: a/T" + std::to_string(i) + "\n";
  EXPECT_THAT(definition_refusal(types), HasSubstr("too many types"));
  for (int i = 0; i < 40; ++i)
    deep += "T" + std::to_string(i) + " a\n" + separator + "\nMSG: a/T" + std::to_string(i) + "\n";
  EXPECT_THAT(definition_refusal(deep), HasSubstr("too deep"));
}

TEST(RosMessageType, does_not_explode_with_types_that_double) {
  // Each type has the next one twice: 2^30 messages without a byte.
  std::string definition = "T0 a\nT0 b\n";
  for (int i = 0; i < 30; ++i) {
    definition += separator + "\nMSG: a/T" + std::to_string(i) + "\n";
    if (i < 29) definition += "T" + std::to_string(i + 1) + " a\nT" + std::to_string(i + 1) + " b\n";
  }
  const MessageType type = MessageType::parse("a/B", definition);
  EXPECT_THAT(refusal([&] { type.to_json({}, plenty); }), HasSubstr("most_bytes"));
  EXPECT_THAT(refusal([&] { type.from_json("{}", plenty); }), HasSubstr("too many values"));
}

TEST(RosMessageType, makes_bytes_of_json_that_give_the_same_json) {
  const std::string definition =
      "bool a\nint8 b\nuint64 c\nfloat32 d\nfloat64[2] e\nstring f\nstring[] g\nuint8[] h\nuint8[2] i\ntime "
      "j\nduration k\n"
      "Inner l\nInner[] m\nint64 n\nfloat64 o\n" +
      separator + "\nMSG: a/Inner\nint16 x\nuint8 y\n";
  const MessageType type = MessageType::parse("a/B", definition);
  const std::string json =
      R"({"a":true,"b":-128,"c":18446744073709551615,"d":0.5,"e":[1.5,-2],"f":"caf\u00e9","g":["x",""],"h":"AQIDBA==",)"
      R"("i":"YWI=","j":{"secs":1,"nsecs":2},"k":{"secs":-1,"nsecs":-2},"l":{"x":-3,"y":4},"m":[{"x":5,"y":6}],)"
      R"("n":-9223372036854775808,"o":null})";
  const std::string bytes = type.from_json(json, plenty);
  const std::string back = type.to_json(bytes_of(bytes), plenty);
  EXPECT_EQ(type.from_json(back, plenty), bytes);
  EXPECT_THAT(back, AllOf(HasSubstr(R"("h":"AQIDBA==","i":"YWI=")"), HasSubstr(R"("l":{"x":-3,"y":4})"),
                          HasSubstr("café"), HasSubstr("\"o\":null")));
  EXPECT_EQ(type.to_json(bytes_of(type.from_json("{}", plenty)), plenty),
            R"({"a":false,"b":0,"c":0,"d":0,"e":[0,0],"f":"","g":[],"h":"","i":"AAA=","j":{"secs":0,"nsecs":0},)"
            R"("k":{"secs":0,"nsecs":0},"l":{"x":0,"y":0},"m":[],"n":0,"o":0})");
  EXPECT_EQ(type.from_json(R"({"h":[1,2,3,4]})", plenty), type.from_json(R"({"h":"AQIDBA=="})", plenty));
  EXPECT_EQ(type.from_json(R"({"l":{"y":4}})", plenty), type.from_json(R"({"l":{"x":0,"y":4}})", plenty));
}

TEST(RosMessageType, says_which_field_of_json_is_wrong) {
  const MessageType type = MessageType::parse("geometry_msgs/Twist", twist);
  const MessageType other = MessageType::parse(
      "a/B", "int8 a\nuint16 b\nbool c\nstring d\nuint8[2] e\nint32[2] f\ntime g\nfloat32 h\nint32[] i\nuint8[] j");
  const auto wrong = [](const MessageType& of, const std::string& json, std::size_t most = plenty) {
    return refusal([&] { of.from_json(json, most); });
  };
  EXPECT_THAT(wrong(type, "[]"), HasSubstr("no JSON object"));
  EXPECT_THAT(wrong(type, "{"), HasSubstr("no JSON object"));
  EXPECT_THAT(wrong(type, R"({"linear":{"q":1}})"), AllOf(HasSubstr("\"linear.q\""), HasSubstr("x, y, z")));
  EXPECT_THAT(wrong(type, R"({"linear":[1,2,3]})"), AllOf(HasSubstr("\"linear\""), HasSubstr("geometry_msgs/Vector3")));
  EXPECT_THAT(wrong(type, R"({"linear":null})"), HasSubstr("\"linear\""));
  EXPECT_THAT(wrong(type, R"({"linear":{"x":"1"}})"), AllOf(HasSubstr("\"linear.x\""), HasSubstr("no number")));
  EXPECT_THAT(wrong(other, R"({"a":128})"), AllOf(HasSubstr("\"a\""), HasSubstr("-128 to 127")));
  EXPECT_THAT(wrong(other, R"({"a":1.5})"), HasSubstr("no whole number"));
  EXPECT_THAT(wrong(other, R"({"b":-1})"), HasSubstr("0 to 65535"));
  EXPECT_THAT(wrong(other, R"({"c":1})"), HasSubstr("neither true nor false"));
  EXPECT_THAT(wrong(other, R"({"d":1})"), HasSubstr("no text"));
  EXPECT_THAT(wrong(other, R"({"e":"YWJj"})"), HasSubstr("3 bytes; it takes 2"));
  EXPECT_THAT(wrong(other, R"({"j":"Y%Jj"})"), HasSubstr("neither base64"));
  EXPECT_THAT(wrong(other, R"({"j":"YWJ"})"), HasSubstr("neither base64"));
  EXPECT_THAT(wrong(other, R"({"f":[1]})"), HasSubstr("1 values; it takes 2"));
  EXPECT_THAT(wrong(other, R"({"i":[1,"x"]})"), HasSubstr("\"i[1]\""));
  EXPECT_THAT(wrong(other, R"({"g":{"secs":1}})"), HasSubstr("nsecs"));
  EXPECT_THAT(wrong(other, R"({"d":"0123456789"})", 12), HasSubstr("most_bytes"));
  EXPECT_THAT(wrong(other, R"({"d":)" + std::string(100'000, '[') + std::string(100'000, ']') + "}"),
              HasSubstr("too deeply"));
}

}  // namespace
}  // namespace iotcloud::drivers::ros
