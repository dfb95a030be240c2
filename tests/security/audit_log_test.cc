// Orders in the audit log: each is on the disk before it is answered, and waits for nobody else's.
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::security {
namespace {

using ::testing::HasSubstr;
using tests::eventually;
using tests::read_file;

AuditEntry order(const std::string& what) {
  AuditEntry entry;
  entry.order = "deploy";
  entry.what = what;
  return entry;
}

/// Stands still until a test moves it.
struct AClock final : config::Clock {
  Instant now() const override { return time; }
  std::int64_t wall_ms() const override { return 0; }
  mutable Instant time{};
};

class AuditLogTest : public ::testing::Test {
 public:
  AuditLogTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-audit-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~AuditLogTest() override { std::filesystem::remove_all(folder_); }

 protected:
  std::string file() const { return folder_ / "audit.log"; }
  std::string text() const { return read_file(file()); }
  std::size_t lines() const {
    const std::string all = text();
    return static_cast<std::size_t>(std::count(all.begin(), all.end(), '\n'));
  }

  std::filesystem::path folder_;
  std::atomic<int> syncs_{0};
  std::optional<AuditLog> log_;
};

TEST_F(AuditLogTest, ALineIsWrittenBeforeItIsBroughtToTheDisk) {
  log_.emplace(file(), [&](int) {
    ++syncs_;
    EXPECT_THAT(text(), HasSubstr("one on g1"));
    return true;
  });
  log_->write(order("one on g1"));
  EXPECT_EQ(syncs_, 1);
  EXPECT_EQ(log_->waiting(), 0u);
}

TEST_F(AuditLogTest, LinesThatComeWhileTheDiskIsBusyAreBroughtThereTogether) {
  constexpr int others = 8;
  log_.emplace(file(), [&](int) {
    if (++syncs_ == 1) {
      EXPECT_TRUE(eventually([&] { return log_->waiting() == 1 + others; }));
    }
    return true;
  });
  {
    std::vector<std::jthread> writers;
    writers.emplace_back([&] { log_->write(order("first")); });
    ASSERT_TRUE(eventually([&] { return syncs_ == 1; }));
    for (int i = 0; i < others; ++i) {
      writers.emplace_back([&, i] { log_->write(order(std::to_string(i))); });
    }
  }
  EXPECT_EQ(syncs_, 2);
  EXPECT_EQ(lines(), 1u + others);
  EXPECT_EQ(log_->waiting(), 0u);
}

TEST_F(AuditLogTest, LinesThatAreGivenTogetherAreBroughtThereTogether) {
  log_.emplace(file(), [&](int) { return ++syncs_ > 0; });
  std::vector<AuditLog::Counted> counted(100, {order("one on g1"), 0});
  counted.push_back({order("two on g1"), 7});
  log_->write_all(counted);
  log_->write_begun({order("three on g1"), order("four on g1")});
  EXPECT_EQ(syncs_, 2);
  EXPECT_EQ(lines(), 103u);
  EXPECT_THAT(text(), AllOf(HasSubstr("\"unwritten\":7"), HasSubstr("four on g1"), HasSubstr("\"begun\"")));
  log_->write_all({});
  EXPECT_EQ(syncs_, 2) << "nothing to write";
}

TEST_F(AuditLogTest, RefusalsThatAreToBeWrittenLaterAreLimitedBeforeTheyWait) {
  log_.emplace(file(), [&](int) { return ++syncs_ > 0; });
  std::vector<AuditLog::Counted> waiting;
  for (int i = 0; i < 5000; ++i) {
    if (auto line = log_->count_refused(order("forged"))) waiting.push_back(*std::move(line));
  }
  EXPECT_LE(waiting.size(), 30u);
  EXPECT_EQ(syncs_, 0);
}

TEST_F(AuditLogTest, TheOldFileGetsNothingMoreOnceTheNewOneIsOpen) {
  std::atomic<bool> synced{false};
  std::jthread reopening;
  log_.emplace(file(), [&](int) {
    if (++syncs_ > 1) return true;
    std::filesystem::rename(file(), file() + ".1");
    reopening = std::jthread([&] {
      log_->reopen();
      EXPECT_TRUE(synced);
    });
    EXPECT_TRUE(eventually([&] { return std::filesystem::exists(file()); })) << "the new one is made meanwhile";
    synced = true;
    return true;
  });
  log_->write(order("old"));
  reopening.join();
  log_->write(order("new"));
  EXPECT_THAT(read_file(file() + ".1"), HasSubstr("old"));
  EXPECT_THAT(text(), HasSubstr("new"));
  EXPECT_EQ(lines(), 1u);
}

TEST_F(AuditLogTest, WhatTheDiskDoesNotTakeKeepsNobodyWaiting) {
  log_.emplace(file(), [&](int) {
    ++syncs_;
    errno = EIO;
    return false;
  });
  log_->write(order("one"));
  log_->write(order("two"));
  EXPECT_EQ(syncs_, 2);
}

TEST_F(AuditLogTest, AnOrderWhoseLineTheDiskDoesNotTakeIsRefusedIfTheSettingsSaySo) {
  bool full = true;
  const auto sync = [&](int) {
    errno = ENOSPC;
    return !full;
  };
  log_.emplace(AuditSettings{file(), AuditSettings::WhenFull::refuse}, sync);
  EXPECT_THROW(log_->write_begun(order("one")), config::Error);
  full = false;
  EXPECT_NO_THROW(log_->write_begun(order("two")));
  full = true;
  log_.reset();
  log_.emplace(AuditSettings{file(), AuditSettings::WhenFull::go_on}, sync);
  EXPECT_NO_THROW(log_->write_begun(order("three")));
}

TEST_F(AuditLogTest, AFullDiskLeavesNoHalfLine) {
  std::filesystem::create_symlink("/dev/full", file());
  log_.emplace(file());
  EXPECT_FALSE(log_->write(order("one")));
  EXPECT_EQ(read_audit_head(file())->number, 0u);
}

TEST_F(AuditLogTest, AFloodOfRefusalsOfOneIdentityFillsNoDiskAndIsCounted) {
  constexpr int flood = 5000, written = 20;
  const AClock clock;
  log_.emplace(
      AuditSettings{file(), {}}, [&](int) { return ++syncs_ > 0; }, clock);
  AuditEntry vera = order("");
  vera.who = "vera";
  for (int i = 0; i < flood; ++i) log_->write_refused(vera);
  EXPECT_EQ(syncs_, written);
  AuditEntry stranger = order("");
  for (int i = 0; i < flood; ++i) {
    stranger.address = "192.0.2.7:" + std::to_string(1000 + i);  // ports do not make it another one
    log_->write_refused(stranger);
  }
  EXPECT_EQ(syncs_, 2 * written);
  clock.time += std::chrono::seconds(3);
  EXPECT_TRUE(log_->write_refused(vera));
  EXPECT_FALSE(log_->write_refused(vera));
  EXPECT_THAT(text(), HasSubstr("\"unwritten\":" + std::to_string(flood - written)));
  log_.reset();  // tells what is left
  EXPECT_EQ(lines(), 2u * written + 1 + 2);
}

TEST_F(AuditLogTest, AStrangerWithManyAddressesTakesNoViewersAllowanceAndKeepsItsOwnOnesOnlyWhileItGoesOn) {
  const AClock clock;
  log_.emplace(
      AuditSettings{file(), {}}, [&](int) { return ++syncs_ > 0; }, clock);
  const auto stranger = [](int host) {
    AuditEntry entry = order("");
    entry.address = "192.0." + std::to_string(host / 250) + "." + std::to_string(host % 250) + ":1000";
    return entry;
  };
  const auto viewer = [](const std::string& name) {
    AuditEntry entry = order("");
    entry.who = name;
    return entry;
  };
  constexpr int hosts = 400, each = 30;
  for (int host = 0; host < hosts; ++host) {
    for (int i = 0; i < each; ++i) log_->write_refused(stranger(host));
  }
  for (const std::string name : {"vera", "victor"}) {
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(log_->write_refused(viewer(name))) << name << " has one of its own, " << i;
    EXPECT_FALSE(log_->write_refused(viewer(name)));
  }
  const auto at_once = lines();
  EXPECT_LT(at_once, 257u * 20 + 41) << "the rest of the hosts share one";
  EXPECT_FALSE(log_->write_refused(stranger(hosts + 1)));

  clock.time += std::chrono::seconds(60);
  for (const int host : {hosts + 1, hosts + 2}) {
    for (int i = 0; i < 20; ++i) EXPECT_TRUE(log_->write_refused(stranger(host))) << "a new host has its own again";
    EXPECT_FALSE(log_->write_refused(stranger(host)));
  }
  const std::string all = text();
  std::uint64_t told = 0;
  for (auto at = all.find("\"unwritten\":"); at != std::string::npos; at = all.find("\"unwritten\":", at + 1))
    told += 1 + std::stoull(all.substr(at + 12));
  EXPECT_EQ(told, hosts * each + 1 - 257u * 20) << "what had no line, once its host is forgotten";
  log_.reset();  // before its clock
}

}  // namespace
}  // namespace iotcloud::security
