#include <fstream>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/slow_file.h>

namespace iotcloud::security {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class Tokens : public testing::Test {
 protected:
  std::string text() const {
    std::ostringstream all;
    all << std::ifstream(file_).rdbuf();
    return all.str();
  }
  void write(const std::string& text) const { std::ofstream(file_) << text; }
  std::string problem() const {
    try {
      read_tokens(file_);
    } catch (const config::Error& e) {
      return e.what();
    }
    return "";
  }

  const tests::TemporaryFolder folder_;
  const std::string file_ = folder_ / "tokens";
};

TEST_F(Tokens, AreKnownByTheirHolderAndKeptAsHashes) {
  const auto anna = add_token(file_, "anna", Role::operating);
  const auto bob = add_token(file_, "bob", Role::viewer);
  EXPECT_NE(anna, bob);
  EXPECT_THAT(text(), AllOf(HasSubstr("anna:operator:scrypt$"), HasSubstr("bob:viewer:scrypt$"),
                            Not(HasSubstr(anna.substr(5))), Not(HasSubstr(bob.substr(4)))));
  struct stat status {};
  ASSERT_EQ(stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600u);

  const TokenKeeper keeper(file_);
  ASSERT_TRUE(keeper.holder(anna, ""));
  EXPECT_EQ(keeper.holder(anna, "")->name, "anna");
  EXPECT_EQ(keeper.holder(anna, "")->role, Role::operating);
  EXPECT_EQ(keeper.holder(bob, "")->name, "bob");
}

TEST_F(Tokens, WhatIsNobodysIsNobodys) {
  const auto anna = add_token(file_, "anna", Role::admin);
  const auto bob = add_token(file_, "bob", Role::viewer);
  const TokenKeeper keeper(file_);
  for (const std::string& wrong :
       {std::string(), std::string("anna"), std::string("anna."), anna + "0", anna.substr(0, anna.size() - 1),
        anna.substr(5), "bob." + anna.substr(5), "eve." + anna.substr(5), std::string(100'000, 'a'),
        "anna." + read_tokens(file_).at(0).hash})
    EXPECT_FALSE(keeper.holder(wrong, "")) << wrong.substr(0, 100);
}

TEST_F(Tokens, CostAHashOnlyUntilTheyWereFoundToBeSomebodys) {
  const auto anna = add_token(file_, "anna", Role::admin);
  TokenKeeper keeper(file_);
  EXPECT_TRUE(keeper.costs(anna));
  ASSERT_TRUE(keeper.holder(anna, ""));
  EXPECT_FALSE(keeper.costs(anna));
  EXPECT_TRUE(keeper.holder(anna, ""));
  EXPECT_FALSE(keeper.holder("anna.wrong", ""));
  EXPECT_TRUE(keeper.costs("anna.wrong")) << "a wrong one costs each time";
  EXPECT_FALSE(keeper.costs(anna)) << "and a right one nothing afterwards";
  EXPECT_FALSE(keeper.costs("eve.wrong")) << "nobody of that name";
  ASSERT_TRUE(remove_token(file_, "anna"));
  const auto next = add_token(file_, "anna", Role::viewer);
  keeper.reload();
  EXPECT_FALSE(keeper.holder(anna, "")) << "it was replaced";
  EXPECT_EQ(keeper.holder(next, "")->role, Role::viewer);
}

TEST_F(Tokens, OfADaemonCountOnlyWithTheCertificateThatTheyWereMadeFor) {
  const auto daemon = add_token(file_, "master-1", Role::master, "CN=master-1");
  const auto person = add_token(file_, "anna", Role::admin);
  EXPECT_THAT(text(), HasSubstr(":CN=master-1\n"));
  TokenKeeper keeper(file_);
  const auto holder = keeper.holder(daemon, "CN=master-1");
  ASSERT_TRUE(holder);
  EXPECT_EQ(holder->role, Role::master);
  for (const char* other : {"", "CN=gateway-1", "CN=master-1,O=x", "CN=master-10"})
    EXPECT_FALSE(keeper.holder(daemon, other)) << other;
  EXPECT_TRUE(keeper.holder(person, "CN=laptop")) << "a person's token may come from anywhere";

  ASSERT_TRUE(remove_token(file_, "anna"));
  EXPECT_THAT(text(), HasSubstr(":CN=master-1\n")) << "another's change keeps it";
  std::string loosened = text();
  loosened.replace(loosened.find("CN=master-1"), 11, "CN=gateway-1");
  write(loosened);
  keeper.reload();
  EXPECT_FALSE(keeper.role_of(*holder)) << "an open connection has no rights any more";
}

TEST_F(Tokens, OfAMasterNeedACertificate) {
  EXPECT_THROW(add_token(file_, "master-1", Role::master), config::Error);
  add_token(file_, "master-1", Role::master, "CN=2001:db8::7");
  EXPECT_EQ(read_tokens(file_).front().certificate, "CN=2001:db8::7");
  std::string bare = text();
  bare.erase(bare.find(":CN="));
  write(bare + "\n");
  EXPECT_THAT(problem(), HasSubstr("--certificate"));
  EXPECT_THROW(add_token(file_, "anna", Role::viewer, "CN=a\nanna2:admin:x"), config::Error);
}

TEST_F(Tokens, WithAnEndAreWorthNothingFromThenOnUnlessTheyAreRenewed) {
  tests::HandClock clock;
  config::Metrics metrics;
  constexpr std::int64_t day = std::int64_t{24} * 3600;
  const auto start = clock.wall_ms() / 1000;
  const auto bob = add_token(file_, "bob", Role::viewer);
  const auto anna = add_token(file_, "anna", Role::admin, "CN=a:b", start + 3 * day);
  EXPECT_THAT(text(), HasSubstr("anna:admin/20200104T000000Z:scrypt$"));
  EXPECT_EQ(read_tokens(file_).at(1).expires_s, start + 3 * day);
  EXPECT_EQ(read_tokens(file_).at(1).certificate, "CN=a:b");
  TokenKeeper keeper(file_, "api", clock, metrics);
  const auto days = [&] {
    const auto samples = metrics.collect();
    return samples.size() == 1 ? samples.front().value : -1000;
  };
  EXPECT_EQ(days(), 3) << "bob's has no end";
  const auto entry = keeper.holder(anna, "CN=a:b");
  ASSERT_TRUE(entry);
  clock.advance(std::chrono::hours(72) - std::chrono::seconds(1));
  EXPECT_EQ(days(), 0);
  EXPECT_EQ(keeper.role_of(*entry), Role::admin);
  clock.advance(std::chrono::seconds(1));
  EXPECT_FALSE(keeper.role_of(*entry)) << "an open connection has no rights any more";
  std::string why;
  EXPECT_FALSE(keeper.holder(anna, "CN=a:b", &why));
  EXPECT_THAT(why, AllOf(HasSubstr("anna expired 2020-01-04 00:00:00 UTC"), HasSubstr("token renew anna")));
  why.clear();
  EXPECT_FALSE(keeper.holder(anna + "0", "CN=a:b", &why));
  EXPECT_EQ(why, "") << "who does not have it learns nothing";
  EXPECT_TRUE(keeper.holder(bob, ""));

  EXPECT_TRUE(renew_token(file_, "anna", start + 5 * day));
  EXPECT_FALSE(renew_token(file_, "eve", start + 5 * day));
  keeper.reload();
  EXPECT_TRUE(keeper.holder(anna, "CN=a:b"));
  EXPECT_EQ(keeper.role_of(*entry), Role::admin);
  EXPECT_EQ(days(), 2);
}

TEST_F(Tokens, AnEndThatIsNoTimeIsNamedWithItsLine) {
  add_token(file_, "anna", Role::viewer, "", 1'900'000'000);
  const std::string good = text();
  for (const char* wrong : {"", "soon", "2030", "20300317T174640", "20301317T174640Z", "20300317T174640Z ", "0"}) {
    std::string bytes = good;
    bytes.replace(bytes.find('/') + 1, 16, wrong);
    write(bytes);
    EXPECT_THAT(problem(), AllOf(HasSubstr(":1:"), HasSubstr("no end of a token"))) << wrong;
  }
}

TEST_F(Tokens, TheSameTokenTwiceHasAnotherHash) {
  add_token(file_, "anna", Role::admin);
  const auto first = read_tokens(file_).at(0).hash;
  EXPECT_TRUE(remove_token(file_, "anna"));
  add_token(file_, "anna", Role::admin);
  EXPECT_NE(read_tokens(file_).at(0).hash, first);
}

TEST_F(Tokens, OneThatIsTakenAwayOrMadeAnewIsWorthNothingAfterReloading) {
  const auto anna = add_token(file_, "anna", Role::admin);
  add_token(file_, "bob", Role::viewer);
  const tests::HandClock clock;
  TokenKeeper keeper(file_, "", clock);
  const auto entry = keeper.holder(anna, "");
  ASSERT_TRUE(entry);
  EXPECT_EQ(keeper.role_of(*entry), Role::admin);
  EXPECT_TRUE(remove_token(file_, "anna"));
  EXPECT_FALSE(remove_token(file_, "anna"));
  EXPECT_EQ(keeper.role_of(*entry), Role::admin) << "it was not told yet";
  add_token(file_, "anna", Role::viewer);
  keeper.reload();
  EXPECT_FALSE(keeper.role_of(*entry));
  EXPECT_FALSE(keeper.holder(anna, ""));
}

TEST_F(Tokens, OneThatIsTakenAwayIsWorthNothingSoonAfterWithoutBeingToldSo) {
  const auto anna = add_token(file_, "anna", Role::admin);
  const auto bob = add_token(file_, "bob", Role::viewer);
  tests::HandClock clock;
  TokenKeeper keeper(file_, "", clock);
  const auto entry = keeper.holder(anna, "");
  ASSERT_TRUE(entry);
  EXPECT_TRUE(remove_token(file_, "anna"));
  clock.advance(TokenKeeper::look_period);
  EXPECT_FALSE(keeper.role_of(*entry)) << "an open connection";
  EXPECT_FALSE(keeper.holder(anna, ""));
  const auto eve = add_token(file_, "eve", Role::viewer);
  clock.advance(TokenKeeper::look_period);
  EXPECT_TRUE(keeper.holder(eve, ""));

  const tests::CapturedLog log;
  write("nonsense\n");
  for (int i = 0; i < 3; ++i) {
    clock.advance(TokenKeeper::look_period);
    EXPECT_TRUE(keeper.holder(bob, "")) << "a file that is of no use changes nothing";
  }
  const auto said = log.text();
  EXPECT_NE(said.find("still count"), std::string::npos) << said;
  EXPECT_EQ(said.find("still count"), said.rfind("still count")) << "said once";
}

TEST_F(Tokens, OneThatIsTakenAwayDoesNotComeBackByAThreadThatHasReadTheFileBefore) {
  const auto anna = add_token(file_, "anna", Role::admin);
  add_token(file_, "bob", Role::viewer);
  const tests::HandClock clock;
  TokenKeeper keeper(file_, "", clock);
  const auto entry = keeper.holder(anna, "");
  ASSERT_TRUE(entry);
  const std::string before = text();
  ASSERT_TRUE(remove_token(file_, "anna"));
  test::reload_around_a_change(file_, before, text(), [&] { keeper.reload(); });
  EXPECT_FALSE(keeper.role_of(*entry));
  EXPECT_FALSE(keeper.holder(anna, ""));
}

TEST_F(Tokens, AFileThatIsWrongChangesNothingWhenItIsReadAgain) {
  const auto anna = add_token(file_, "anna", Role::admin);
  TokenKeeper keeper(file_);
  write("nonsense\n");
  EXPECT_THROW(keeper.reload(), config::Error);
  EXPECT_TRUE(keeper.holder(anna, ""));
}

TEST_F(Tokens, ASecondOneOfTheSameNameIsRefused) {
  add_token(file_, "anna", Role::admin);
  EXPECT_THROW(add_token(file_, "anna", Role::viewer), config::Error);
  for (const char* name : {"", "a:b", "a.b", "a b", "a/b", "ä"})
    EXPECT_THROW(add_token(file_, name, Role::viewer), config::Error);
}

TEST_F(Tokens, LinesThatAreWrongAreNamed) {
  add_token(file_, "anna", Role::admin);
  const auto good = text();
  write("# comment\n\n" + good);
  EXPECT_EQ(problem(), "");
  write(good + "bob:admin:secret\n");
  EXPECT_THAT(problem(), HasSubstr("tokens:2:"));
  write(good + "bob:king" + good.substr(good.rfind(':')));
  EXPECT_THAT(problem(), AllOf(HasSubstr("tokens:2:"), HasSubstr("king"), HasSubstr("viewer")));
  write(good + good);
  EXPECT_THAT(problem(), AllOf(HasSubstr("tokens:2:"), HasSubstr("anna")));
}

TEST_F(Tokens, AFileThatEverybodyMayWriteIsRefusedWithTheRemedy) {
  add_token(file_, "anna", Role::admin);
  ASSERT_EQ(chmod(file_.c_str(), 0666), 0);
  EXPECT_THAT(problem(), HasSubstr("chmod 600"));
}

}  // namespace
}  // namespace iotcloud::security
