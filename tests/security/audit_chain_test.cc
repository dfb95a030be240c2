// Attacks on an audit log, and what a verification says of each.
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::security {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using tests::read_file;
using tests::write_file;

class AuditChain : public ::testing::Test {
 protected:
  AuditChain() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-chain-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~AuditChain() override { std::filesystem::remove_all(folder_); }

  static bool no_sync(int) { return true; }
  void open() { log_.emplace(file(), no_sync); }
  void write(int count) {
    for (int i = 0; i < count; ++i) {
      AuditEntry entry;
      entry.who = "anna";
      entry.what = "order " + std::to_string(++written_);
      EXPECT_TRUE(log_->write(entry));
    }
  }
  std::string file() const { return folder_ / "audit.log"; }
  std::vector<std::string> lines() const {
    std::ifstream in(file());
    std::vector<std::string> all;
    for (std::string line; std::getline(in, line);) all.push_back(line);
    return all;
  }
  void put(const std::vector<std::string>& lines) const {
    std::string all;
    for (const auto& line : lines) all += line + "\n";
    write_file(file(), all);
  }
  AuditVerdict verdict(const AuditExpectation& expected = {}) const { return verify_audit({file()}, expected); }
  std::vector<std::string> findings(AuditExpectation expected = {}) const {
    std::vector<std::string> texts;
    for (const auto& finding : verdict(std::move(expected)).findings) texts.push_back(finding.text);
    return texts;
  }

  std::filesystem::path folder_;
  std::optional<AuditLog> log_;
  int written_ = 0;
};

TEST_F(AuditChain, ALogThatNobodyTouchedIsInOrderAlsoOverRestartsAndRotation) {
  open();
  write(3);
  log_.reset();
  open();
  write(2);
  std::filesystem::rename(file(), file() + ".1");
  log_->reopen();
  write(2);
  log_->reopen();  // without a rotation
  write(1);
  const auto both = verify_audit({file() + ".1", file()}, {});
  EXPECT_THAT(both.findings, IsEmpty());
  EXPECT_EQ(both.first, 1u);
  EXPECT_EQ(both.head.number, 8u);
  EXPECT_EQ(both.head, read_audit_head(file()));
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines 1 to 5 are in an older file, or were removed")));
  AuditExpectation newer;
  newer.from = 6;
  EXPECT_THAT(findings(newer), IsEmpty());
}

TEST_F(AuditChain, AChangedLineIsFound) {
  open();
  write(5);
  auto all = lines();
  all[2].replace(all[2].find("anna"), 4, "otto");
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("line 3 was changed")));
  all = lines();
  all[2].replace(all[2].find("otto"), 4, "anna");
  all[4].replace(all[4].find("anna"), 4, "otto");  // the last one, which has no successor
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("line 5, the last one, was changed")));
}

TEST_F(AuditChain, ARemovedLineIsFound) {
  open();
  write(5);
  auto all = lines();
  all.erase(all.begin() + 1, all.begin() + 3);
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines 2 to 3 are missing")));
}

TEST_F(AuditChain, LinesInAnotherOrderAreFound) {
  open();
  write(5);
  auto all = lines();
  std::swap(all[1], all[2]);
  put(all);
  EXPECT_THAT(findings(), testing::Contains(HasSubstr("line 2 comes after line 3: lines were put in another order")));
}

TEST_F(AuditChain, AnAddedLineIsFound) {
  open();
  write(3);
  auto all = lines();
  all.insert(all.begin() + 1, all[1]);
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("line 2 comes after line 2")));
  all[1] = "nothing of ours";
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("no line of an audit log")));
}

TEST_F(AuditChain, ATailThatWasCutOffIsFoundByTheHeadBesideIt) {
  open();
  write(5);
  log_.reset();
  auto all = lines();
  all.resize(3);
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines 4 to 5 are missing at its end")));
  // Also after the daemon went on.
  open();
  write(1);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines 4 to 5 are missing")));
}

TEST_F(AuditChain, ATailIsFoundToBeCutWhileTheDaemonRuns) {
  open();
  write(5);
  auto all = lines();
  all.resize(3);
  put(all);
  write(1);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines 4 to 5 are missing")));
}

TEST_F(AuditChain, AMissingHeadIsNamedAndAHeadThatSomebodyKeptIsCompared) {
  open();
  write(5);
  const AuditHead kept = verdict().head;
  write(2);
  log_.reset();
  AuditExpectation expected;
  expected.known = kept;
  EXPECT_THAT(findings(expected), IsEmpty());
  // The thief cuts the tail, and makes a head that fits.
  auto all = lines();
  all.resize(4);
  put(all);
  write_file(audit_head_file(file()), to_string(AuditHead{4, sha256_hex(all[3])}) + "\n");
  EXPECT_THAT(findings(), IsEmpty()) << "that much the file alone cannot tell";
  EXPECT_THAT(findings(expected), ElementsAre(HasSubstr("line 5, which was there once, is missing")));
  std::filesystem::remove(audit_head_file(file()));
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("nothing says whether the end was cut off")));
  AuditExpectation rotated;
  rotated.has_head = false;
  EXPECT_THAT(findings(rotated), IsEmpty());
}

/// SECURITY.md: what whoever may write the file has of it.
TEST_F(AuditChain, AThiefWritesLinesOfItsOwnFromNowOnThatNobodyCanTell) {
  open();
  write(3);
  AuditExpectation expected;
  expected.known = verdict().head;
  log_.reset();
  AuditLog thief(file(), no_sync);
  AuditEntry untrue;
  untrue.who = "anna";
  untrue.what = "what she never did";
  ASSERT_TRUE(thief.write(untrue));
  EXPECT_THAT(lines().back(), HasSubstr("what she never did"));
  EXPECT_THAT(findings(expected), IsEmpty()) << "also for whoever kept the head";
}

TEST_F(AuditChain, LinesOfAnEarlierVersionAreVouchedForByTheFirstLineOfTheChain) {
  const std::string old = "{\"time\":\"2026\",\"who\":\"anna\"}\n{\"time\":\"2026\",\"who\":\"otto\"}\n";
  write_file(file(), old);
  open();
  write(2);
  EXPECT_THAT(findings(), IsEmpty());
  EXPECT_EQ(verdict().unchained, 2u);
  auto all = lines();
  all[0].replace(all[0].find("anna"), 4, "vera");
  put(all);
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("lines before line 1 were changed")));
}

TEST_F(AuditChain, ALineThatACrashLeftUnfinishedIsCutOffAndTheChainGoesOn) {
  open();
  write(2);
  log_.reset();
  std::ofstream(file(), std::ios::app) << R"({"number":3,"previous":"12)";
  EXPECT_THAT(findings(), ElementsAre(HasSubstr("not written to its end")));
  open();
  write(1);
  EXPECT_THAT(findings(), IsEmpty());
  EXPECT_EQ(verdict().head.number, 3u);
}

TEST_F(AuditChain, AHeadThatIsOlderThanTheLogIsThatOfACrash) {
  open();
  write(1);
  const std::string head = read_file(audit_head_file(file()));
  write(2);
  log_.reset();
  write_file(audit_head_file(file()), head);
  EXPECT_THAT(findings(), IsEmpty());
  open();
  write(1);
  EXPECT_THAT(findings(), IsEmpty());
}

TEST_F(AuditChain, ASecondWriterIsRefused) {
  open();
  try {
    AuditLog other(file(), no_sync);
    FAIL() << "two daemons would break each other's chain";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr("another process writes it"), HasSubstr("a file of its own")));
  }
}

}  // namespace
}  // namespace iotcloud::security
