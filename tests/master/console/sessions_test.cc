#include <set>

#include <gtest/gtest.h>

#include <iotcloud/master/console/sessions.h>
#include <iotcloud/tests/config/hand_clock.h>

namespace iotcloud::master {
namespace {

using namespace std::chrono_literals;

security::TokenEntry anna() {
  security::TokenEntry entry;
  entry.name = "anna";
  return entry;
}

TEST(Sessions, BelongToWhomHasTheSecretUntilTheyAreEnded) {
  Sessions sessions({});
  const auto secret = sessions.begin(anna());
  EXPECT_EQ(secret.size(), 64u);
  ASSERT_TRUE(sessions.find(secret));
  EXPECT_EQ(sessions.find(secret)->name, "anna");
  EXPECT_FALSE(sessions.find(""));
  EXPECT_FALSE(sessions.find(secret.substr(1)));
  sessions.end(secret);
  EXPECT_FALSE(sessions.find(secret));
}

TEST(Sessions, EndWhenNothingIsAskedAndAtTheLatestWhenTheirTimeIsOver) {
  tests::HandClock clock;
  Sessions sessions({.longest = 10min, .idle = 3min}, clock);
  const auto used = sessions.begin(anna()), idle = sessions.begin(anna());
  for (int i = 0; i < 4; ++i) {
    clock.advance(2min);
    EXPECT_TRUE(sessions.find(used)) << i;
  }
  EXPECT_FALSE(sessions.find(idle));
  clock.advance(2min);
  EXPECT_FALSE(sessions.find(used)) << "ten minutes after the log-in";
  EXPECT_EQ(sessions.size(), 0u);
}

TEST(Sessions, OfOneNameHaveALimitAtWhichTheOldestEnds) {
  tests::HandClock clock;
  Sessions sessions({.most_of_one = 3}, clock);
  const auto first = sessions.begin(anna());
  std::set<std::string> later;
  for (int i = 0; i < 3; ++i) {
    clock.advance(1s);
    later.insert(sessions.begin(anna()));
  }
  EXPECT_EQ(later.size(), 3u);
  EXPECT_FALSE(sessions.find(first));
  for (const auto& secret : later) EXPECT_TRUE(sessions.find(secret));
}

TEST(Sessions, AreFoundInTheHeaderCookie) {
  EXPECT_EQ(cookie_in("a=1; session=abc; b=2", "session"), "abc");
  EXPECT_EQ(cookie_in("session=abc", "session"), "abc");
  EXPECT_EQ(cookie_in("my_session=abc", "session"), "");
  EXPECT_EQ(cookie_in("", "session"), "");
  EXPECT_EQ(cookie_in("a=session=1;", "session"), "");
}

}  // namespace
}  // namespace iotcloud::master
