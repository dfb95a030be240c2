#include <limits>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {
namespace {

std::vector<std::byte> encoded_bytes(const Values& values) {
  std::vector<std::byte> bytes(encoded_size(values.all()));
  EXPECT_EQ(encode_values(values.all(), bytes.data()), bytes.data() + bytes.size());
  return bytes;
}

Values every_kind() {
  return Values(std::monostate(), true, false, std::int64_t{-1}, std::numeric_limits<std::int64_t>::min(), 2.5,
                "z\xC3\xA4hlt", Payload::copy(std::string("\0\xFF", 2)), "");
}

std::string why_refused(std::span<const std::byte> bytes, std::int64_t* birth = nullptr) {
  try {
    static_cast<void>(decode_values(bytes, birth));
  } catch (const ValueFormatError& error) {
    return error.what();
  }
  return "";
}

TEST(StormValues, ComeBackAsTheyWere) {
  const Values values = every_kind();
  const Values again = decode_values(encoded_bytes(values));
  ASSERT_EQ(again.size(), values.size());
  for (std::size_t i = 0; i < values.size(); ++i) EXPECT_EQ(again[i], values[i]) << i;
}

TEST(StormValues, ThatJavaFindsElsewhereAreNotAmongTheBytes) {
  const Payload payload = Payload::copy(std::string(1000, 'x'));
  const Values values("a", payload, payload, "b");
  const std::vector<std::optional<JavaValue>> elsewhere{std::nullopt, JavaValue{3, 2}, JavaValue{}};
  std::vector<std::byte> bytes(encoded_size(values.all(), elsewhere));
  EXPECT_EQ(encode_values(values.all(), bytes.data(), elsewhere), bytes.data() + bytes.size());
  EXPECT_EQ(bytes.size(), 4U + 6 + 9 + 1 + 6);
  EXPECT_EQ(bytes[4 + 6], std::byte{7});
  EXPECT_EQ(bytes[4 + 6 + 1], std::byte{3});
  EXPECT_EQ(bytes[4 + 6 + 5], std::byte{2});
  EXPECT_EQ(bytes[4 + 6 + 9], std::byte{8});
}

TEST(StormValues, ArraysAreTakenInTheirOrder) {
  struct Arrays final : JavaArrays {
    Payload next() override { return Payload::copy(std::to_string(++count)); }
    int count = 0;
  } arrays;
  const Payload large = Payload::copy(std::string("large"));
  const Values values(large, "between", large);
  const std::vector<std::optional<JavaValue>> elsewhere{JavaValue{}, std::nullopt, JavaValue{}};
  std::vector<std::byte> bytes(encoded_size(values.all(), elsewhere));
  encode_values(values.all(), bytes.data(), elsewhere);
  const Values read = decode_values(bytes, nullptr, &arrays);
  ASSERT_EQ(read.size(), 3U);
  EXPECT_EQ(std::get<Payload>(read[0]).text(), "1");
  EXPECT_EQ(std::get<std::string>(read[1]), "between");
  EXPECT_EQ(std::get<Payload>(read[2]).text(), "2");
  EXPECT_EQ(why_refused(bytes), "there is no value of kind 8");
}

TEST(StormValues, AreRefusedWhenTheyEndEarlyOrLate) {
  auto bytes = encoded_bytes(every_kind());
  for (std::size_t size = 0; size < bytes.size(); ++size) EXPECT_NE(why_refused({bytes.data(), size}), "") << size;
  bytes.push_back(std::byte{0});
  EXPECT_EQ(why_refused(bytes), "1 bytes follow the last value");
}

TEST(StormValues, AreRefusedWhenOfNoKnownKind) {
  auto bytes = encoded_bytes(Values(true));
  bytes.back() = std::byte{7};
  EXPECT_EQ(why_refused(bytes), "there is no value of kind 7");
}

TEST(StormValues, TheBirthIsTheLastOne) {
  std::int64_t birth = 0;
  const Values values = decode_values(encoded_bytes(Values("a", std::int64_t{1700000000000})), &birth);
  EXPECT_EQ(values.size(), 1U);
  EXPECT_EQ(birth, 1700000000000);
  EXPECT_EQ(why_refused(encoded_bytes(Values("a")), &birth), "the birth is a string");
  EXPECT_EQ(why_refused(encoded_bytes(Values()), &birth), "there is no value, so no birth");
}

TEST(StormValues, StringsAreUtf8) {
  for (const char* good : {"", "plain text of more than eight bytes", "\xC2\x80", "\xE0\xA0\x80", "\xEF\xBF\xBD",
                           "\xF0\x90\x80\x80", "\xF4\x8F\xBF\xBF", "12345678\xC3\xA4"}) {
    EXPECT_NO_THROW(static_cast<void>(encoded_bytes(Values(good)))) << good;
  }
  for (const char* bad : {"\xFF", "\x80", "\xC3", "\xC0\xAF", "\xE0\x80\x80", "\xED\xA0\x80", "\xF0\x80\x80\x80",
                          "\xF4\x90\x80\x80", "12345678\xC3"}) {
    EXPECT_THROW(static_cast<void>(encoded_size(Values(bad).all())), ValueFormatError) << bad;
  }
}

}  // namespace
}  // namespace iotcloud::topology::storm
