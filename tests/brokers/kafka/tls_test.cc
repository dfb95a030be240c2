// Kafka behind TLS with client certificates, users and passwords.
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

using testing::HasSubstr;
using testing::Not;

class KafkaTls : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("kafka.py", {"--tls"}); }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }

  static std::string file(const char* name) { return (server_->folder() / name).string(); }
  /// Those that the server wants.
  static BrokerOptions options() {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.user = tests::server_user;
    options.password_file = file("password");
    std::ofstream(options.password_file) << tests::server_password << "\n";
    options.tls = {file("ca.pem"), file("client.pem"), file("client.key")};
    options.heartbeat = std::chrono::seconds(2);
    return options;
  }
  static Topic topic() {
    return {"", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), false};
  }
  /// What is logged while a broker with these options does not get in.
  static std::string complaint(const BrokerOptions& options) {
    testing::internal::CaptureStdout();
    testing::internal::CaptureStderr();
    {
      const auto broker = make_broker(options);
      const auto publisher = broker->publisher(topic(), {});
      publisher->publish(text_message("x"));
      EXPECT_FALSE(publisher->drain(std::chrono::seconds(2)));
      EXPECT_EQ(broker->state(), ConnectionState::connecting);
    }
    return testing::internal::GetCapturedStdout() + testing::internal::GetCapturedStderr();
  }

  static tests::PrivateServer* server_;
};

tests::PrivateServer* KafkaTls::server_ = nullptr;

TEST_F(KafkaTls, CarriesMessagesOfEverySizeInOrder) {
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  std::vector<std::string> sent;
  for (const std::size_t size : {0, 1, 16'384, 1'000'000, 8'388'608}) {
    sent.emplace_back(size, static_cast<char>('a' + sent.size()));
    ASSERT_EQ(publisher->publish(text_message(sent.back())), PublishStatus::accepted);
  }
  ASSERT_TRUE(inbox.wait_for(sent.size()));
  EXPECT_TRUE(inbox.bodies() == sent);
  EXPECT_TRUE(publisher->drain(patience));
}

TEST_F(KafkaTls, APasswordMayComeFromTheEnvironment) {
  BrokerOptions from_environment = options();
  from_environment.password_file.clear();
  from_environment.password_variable = "IOTCLOUD_TEST_PASSWORD";
  ::setenv("IOTCLOUD_TEST_PASSWORD", tests::server_password, 1);
  const auto broker = make_broker(from_environment);
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }, patience));
}

TEST_F(KafkaTls, AWrongPasswordIsRefusedAndNotPrinted) {
  BrokerOptions wrong = options();
  wrong.password_file = file("wrong");
  std::ofstream(wrong.password_file) << "not the right one\n";
  const std::string log = complaint(wrong);
  EXPECT_THAT(log, HasSubstr("cannot connect"));
  EXPECT_THAT(log, Not(HasSubstr("not the right one")));
}

TEST_F(KafkaTls, APasswordThatChangesIsTakenAtTheNextAttempt) {
  BrokerOptions changing = options();
  changing.password_file = file("changing");
  std::ofstream(changing.password_file) << "not yet\n";
  const auto broker = make_broker(changing);
  EXPECT_FALSE(eventually([&] { return broker->state() == ConnectionState::connected; }, std::chrono::seconds(1)));
  std::ofstream(changing.password_file) << tests::server_password << "\n";
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }, patience));
}

TEST_F(KafkaTls, WithoutAClientCertificateNobodyGetsIn) {
  BrokerOptions bare = options();
  bare.tls.certificate_file.clear();
  bare.tls.key_file.clear();
  EXPECT_THAT(complaint(bare), HasSubstr("cannot connect"));
}

TEST_F(KafkaTls, AServerOfAnotherAuthorityIsNotTrusted) {
  BrokerOptions trusting = options();
  trusting.tls.ca_file.clear();  // the system's authorities do not know it
  EXPECT_THAT(complaint(trusting), HasSubstr("cannot connect"));
}

TEST_F(KafkaTls, FilesThatAreNotThereAreNamed) {
  BrokerOptions missing = options();
  missing.tls.ca_file = file("no-such-file.pem");
  EXPECT_THAT(complaint(missing), HasSubstr("ca.location"));
  missing = options();
  missing.password_file = file("no-such-password");
  EXPECT_THAT(complaint(missing), HasSubstr("no-such-password"));
}

}  // namespace
}  // namespace iotcloud::brokers
