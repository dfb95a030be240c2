#include <cstdint>

#include <gtest/gtest.h>

#include <iotcloud/config/number.h>

namespace iotcloud::config {
namespace {

TEST(ParseNumber, TakesATextThatIsOneNumberAsAWhole) {
  EXPECT_EQ(parse_number<int>("-12"), -12);
  EXPECT_EQ(parse_number<std::uint64_t>("18446744073709551615"), 18446744073709551615U);
  EXPECT_EQ(parse_number<unsigned char>("fe", 16), 0xfe);
  EXPECT_EQ(parse_number<double>("2.5e3"), 2500);
}

TEST(ParseNumber, RefusesWhatIsNoNumberOrMoreThanOneOrTooLarge) {
  for (const char* text : {"", " 1", "1 ", "+1", "1s", "0x10", "1.5", "one"}) {
    EXPECT_FALSE(parse_number<int>(text)) << text;
  }
  EXPECT_FALSE(parse_number<std::uint16_t>("65536"));
  EXPECT_FALSE(parse_number<std::uint16_t>("-1"));
  EXPECT_FALSE(parse_number<unsigned char>("fg", 16));
  for (const char* text : {"", "2.5x", " 2.5", "1e999"}) EXPECT_FALSE(parse_number<double>(text)) << text;
}

}  // namespace
}  // namespace iotcloud::config
