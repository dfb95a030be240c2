#include <filesystem>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/gateway/fleet/broker_files.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::gateway {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

class BrokerFilesTest : public ::testing::Test {
 protected:
  std::string write(const std::string& name, const std::string& text) {
    return tests::write_file(folder_ / name, text);
  }
  std::string copies() const { return folder_ / "copies"; }
  static InstanceSpec spec_with(const std::string& ca, const std::string& revoked) {
    InstanceSpec spec;
    spec.brokers = {{"rabbitmq", "rabbitmq", {}, {}, {}}};
    spec.brokers[0].options.tls.ca_file = ca;
    spec.brokers[0].options.tls.revoked_file = revoked;
    spec.brokers[0].options.properties = {{"reader_password_file", ca}, {"exchange", "amq.topic"}};
    return spec;
  }

  const tests::TemporaryFolder folder_;
};

TEST_F(BrokerFilesTest, PutsItsCopiesInThePlaceOfTheFilesThatABrokerNames) {
  const auto ca = write("ca.pem", "authority");
  const BrokerFiles files(copies(), {ca, ca}, nullptr);
  const auto options = files.with_copies(spec_with(ca, "/else/where.pem")).brokers[0].options;
  EXPECT_EQ(fs::path(options.tls.ca_file).parent_path(), copies());
  EXPECT_EQ(tests::read_file(options.tls.ca_file), "authority");
  EXPECT_EQ(options.properties.at("reader_password_file"), options.tls.ca_file);
  EXPECT_EQ(options.tls.revoked_file, "/else/where.pem") << "which it was not given";
  EXPECT_EQ(options.properties.at("exchange"), "amq.topic");
  EXPECT_EQ(files.with_copies(spec_with(options.tls.ca_file, "")).brokers[0].options.tls.ca_file, options.tls.ca_file)
      << "of an instance that an adopted host had";
  EXPECT_EQ(fs::status(options.tls.ca_file).permissions(), fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(BrokerFilesTest, CopiesAgainWhatWasReplacedOrChangedAndKeepsTheLastCopyOfWhatIsGone) {
  const auto ca = write("ca.pem", "one");
  BrokerFiles files(copies(), {ca}, nullptr);
  const fs::path copy = files.with_copies(spec_with(ca, "")).brokers[0].options.tls.ca_file;
  const auto first = fs::last_write_time(copy);
  files.renew();
  EXPECT_EQ(fs::last_write_time(copy), first) << "nothing changed";
  write("new.pem", "two, longer");
  fs::rename(folder_ / "new.pem", ca);
  files.renew();
  EXPECT_EQ(tests::read_file(copy), "two, longer");
  fs::remove(ca);
  files.renew();
  EXPECT_EQ(tests::read_file(copy), "two, longer");
  write("ca.pem", "three");
  files.renew();
  EXPECT_EQ(tests::read_file(copy), "three");
}

TEST_F(BrokerFilesTest, HaveTheSameNamesInTheNextRunWhichRemovesThoseOfFilesThatNoBrokerNamesAnyMore) {
  const auto ca = write("ca.pem", "authority"), password = write("password", "sesame");
  const auto names = [&](const BrokerFiles& files) { return files.with_copies(spec_with(ca, password)); };
  const auto before = names(BrokerFiles(copies(), {ca, password}, nullptr)).brokers[0].options.tls;
  const auto after = names(BrokerFiles(copies(), {ca}, nullptr)).brokers[0].options.tls;
  EXPECT_EQ(after.ca_file, before.ca_file);
  EXPECT_TRUE(fs::exists(after.ca_file));
  EXPECT_FALSE(fs::exists(before.revoked_file)) << "a password that is of no use any more";
}

TEST_F(BrokerFilesTest, AreCopiedAsSoonAsThatIsPossibleAgainAndTheLogComplainsOnceOfEachChange) {
  const auto ca = write("ca.pem", "one");
  BrokerFiles files(copies(), {ca}, nullptr);
  const fs::path copy = files.with_copies(spec_with(ca, "")).brokers[0].options.tls.ca_file;
  const auto renewals = [&](int count) {
    const tests::CapturedLog log;
    for (int i = 0; i < count; ++i) files.renew();
    return log.text();
  };
  write("ca.pem", "two, longer");
  fs::rename(copies(), folder_ / "elsewhere");  // as if there was no room for a copy
  EXPECT_THAT(renewals(1), HasSubstr("cannot be copied"));
  EXPECT_EQ(renewals(2), "");
  write("ca.pem", "three, even longer");
  EXPECT_THAT(renewals(1), HasSubstr("cannot be copied")) << "it is another change";
  fs::rename(folder_ / "elsewhere", copies());
  EXPECT_THAT(renewals(2), HasSubstr("as it is now"));
  EXPECT_EQ(tests::read_file(copy), "three, even longer");
  EXPECT_EQ(renewals(1), "");
}

TEST_F(BrokerFilesTest, WithTheSameBytesAreTheSameToHostsAlsoInTheNextRun) {
  const auto ca = write("ca.pem", "authority");
  BrokerFiles files(copies(), {ca}, nullptr);
  const fs::path copy = files.with_copies(spec_with(ca, "")).brokers[0].options.tls.ca_file;
  const auto first = config::stamp_of(copy);
  write("new.pem", "authority");
  fs::rename(folder_ / "new.pem", ca);
  files.renew();
  EXPECT_EQ(config::stamp_of(copy), first);
  BrokerFiles(copies(), {ca}, nullptr).renew();
  EXPECT_EQ(config::stamp_of(copy), first);
  fs::permissions(copy, fs::perms::group_read, fs::perm_options::add);  // for hosts that had a user of their own
  const BrokerFiles again(copies(), {ca}, nullptr);
  EXPECT_EQ(fs::status(copy).permissions(), fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(BrokerFilesTest, OfAnEarlierRunServeUntilAFileThatCannotBeCopiedNowCanBe) {
  const auto ca = write("ca.pem", "authority");
  const fs::path copy =
      BrokerFiles(copies(), {ca}, nullptr).with_copies(spec_with(ca, "")).brokers[0].options.tls.ca_file;
  fs::remove(ca);
  const tests::CapturedLog log;
  BrokerFiles files(copies(), {ca}, nullptr);
  EXPECT_THAT(log.text(), AllOf(HasSubstr("cannot be copied"), HasSubstr("ca.pem")));
  EXPECT_EQ(files.with_copies(spec_with(ca, "")).brokers[0].options.tls.ca_file, copy);
  EXPECT_EQ(tests::read_file(copy), "authority");
  write("ca.pem", "another one");
  files.renew();
  EXPECT_EQ(tests::read_file(copy), "another one");
}

TEST_F(BrokerFilesTest, SayWhichFileCannotBeCopied) {
  try {
    const BrokerFiles files(copies(), {folder_ / "missing.pem"}, nullptr);
    FAIL() << "the file is not there";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("missing.pem"));
    EXPECT_THAT(error.what(), HasSubstr("host_files"));
  }
}

}  // namespace
}  // namespace iotcloud::gateway
