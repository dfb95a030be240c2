// ActiveMQ behind TLS with client certificates, users and passwords.
#include <fstream>
#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class ActiveMqTls : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    server_ = std::make_unique<tests::PrivateServer>("activemq.py", std::vector<std::string>{"--tls"});
  }
  static void TearDownTestSuite() { server_.reset(); }

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

  static std::unique_ptr<tests::PrivateServer> server_;
};

std::unique_ptr<tests::PrivateServer> ActiveMqTls::server_;

TEST_F(ActiveMqTls, CarriesMessagesOfEverySizeInOrder) {
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  std::vector<std::string> sent;
  for (const std::size_t size : {0, 1, 16'384, 131'064, 1'000'000, 8'388'608}) {
    sent.emplace_back(size, static_cast<char>('a' + sent.size()));
    ASSERT_EQ(publisher->publish(text_message(sent.back())), PublishStatus::accepted);
  }
  for (int i = 0; i < 300; ++i) {
    sent.push_back(std::to_string(i));
    publisher->publish(text_message(sent.back()));
  }
  ASSERT_TRUE(inbox.wait_for(sent.size()));
  EXPECT_TRUE(inbox.bodies() == sent);
  EXPECT_TRUE(publisher->drain(patience));
}

TEST_F(ActiveMqTls, AWrongPasswordIsSaidAndNotShown) {
  BrokerOptions wrong = options();
  std::ofstream(wrong.password_file) << "hush-hush\n";
  const std::string said = complaint(wrong);
  EXPECT_THAT(said, testing::HasSubstr("cannot connect"));
  EXPECT_THAT(said, testing::Not(testing::HasSubstr("hush-hush")));
}

TEST_F(ActiveMqTls, AServerOfAnotherAuthorityIsNotTrusted) {
  BrokerOptions strict = options();
  strict.tls.ca_file.clear();
  EXPECT_THAT(complaint(strict), testing::HasSubstr("certificate"));
}

TEST_F(ActiveMqTls, AHostThatIsNotTheCertificatesIsNotTrusted) {
  BrokerOptions other = options();
  other.urls.front().replace(other.urls.front().find("localhost"), 9, "127.0.0.2");
  EXPECT_THAT(complaint(other), testing::HasSubstr("cannot connect"));
}

TEST_F(ActiveMqTls, WithoutAClientCertificateThereIsNoWayIn) {
  BrokerOptions bare = options();
  bare.tls.certificate_file.clear();
  bare.tls.key_file.clear();
  EXPECT_THAT(complaint(bare), testing::HasSubstr("cannot connect"));
}

TEST_F(ActiveMqTls, APasswordFileThatIsMissingIsNamed) {
  BrokerOptions missing = options();
  missing.password_file = file("nowhere");
  EXPECT_THAT(complaint(missing), testing::HasSubstr("nowhere"));
}

}  // namespace
}  // namespace iotcloud::brokers
