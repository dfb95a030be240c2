#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/gateway/fleet/host_troubles.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::gateway {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr std::int64_t noon_ms = 1'790'000'000'000;

Stall stall(std::int64_t ms) {
  return {"one"_instance, false, std::chrono::milliseconds(ms), {}};
}

TEST(HostTroubles, NameInstancesThatHangAndThoseThatDropMessages) {
  HostTroubles troubles;
  troubles.put("a", {stall(1'500)}, {}, noon_ms);
  EXPECT_EQ(troubles.trouble(), "") << "a callback may run for a while";
  troubles.put("a", {stall(3'000)}, {{"two"_instance, "readings", "dropped: superseded", noon_ms}}, noon_ms);
  const std::string text = troubles.trouble();
  EXPECT_EQ(text,
            "instance one hangs: a callback of its driver has not returned since 2026-09-21T14:13:17Z; "
            "instance two drops messages: channel readings since 2026-09-21T14:13:20Z, dropped: superseded");
  troubles.put("a", {stall(5'017)}, {{"two"_instance, "readings", "dropped: superseded", noon_ms}}, noon_ms + 2'000);
  EXPECT_EQ(troubles.trouble(), text) << "the same as long as nothing changes";
  troubles.put("a", {}, {}, noon_ms + 3'000);
  EXPECT_EQ(troubles.trouble(), "");
}

TEST(HostTroubles, AreBoundedAndKeepWhatAHostTellsInItsPlace) {
  HostTroubles troubles;
  std::vector<LosingChannel> losing(HostTroubles::most + 5,
                                    {"one"_instance, "a; instance two hangs: not", "x", noon_ms});
  troubles.put("a", {}, losing, noon_ms);
  troubles.put("b", {}, {{"three"_instance, std::string(5'000, 'x'), "y", noon_ms}}, noon_ms);
  const std::string text = troubles.trouble();
  EXPECT_THAT(text, Not(HasSubstr("; instance two hangs")));
  EXPECT_THAT(text, HasSubstr("; 1 more such instances"));
  EXPECT_LT(text.size(), 10'000U);
  troubles.forget("a");
  EXPECT_THAT(troubles.trouble(), HasSubstr("instance three drops messages"));
  EXPECT_LT(troubles.trouble().size(), 300U);
}

}  // namespace
}  // namespace iotcloud::gateway
