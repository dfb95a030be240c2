// RabbitMQ behind TLS with client certificates, users and passwords.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class RabbitMqTls : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("rabbitmq.py", {"--tls"}); }
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
    return {"tls", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), false};
  }
  /// What is logged while a broker with these options does not get in.
  static std::string complaint(const BrokerOptions& options) {
    testing::internal::CaptureStdout();
    testing::internal::CaptureStderr();
    {
      const auto broker = make_broker(options);
      const auto publisher = broker->publisher(topic(), {});
      publisher->publish(text_message("x"));
      EXPECT_FALSE(publisher->drain(std::chrono::seconds(1)));
      EXPECT_EQ(broker->state(), ConnectionState::connecting);
    }
    return testing::internal::GetCapturedStdout() + testing::internal::GetCapturedStderr();
  }

  static tests::PrivateServer* server_;
};

tests::PrivateServer* RabbitMqTls::server_ = nullptr;

std::size_t count(const std::string& text, const std::string& word) {
  std::size_t found = 0;
  for (auto at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) ++found;
  return found;
}

TEST_F(RabbitMqTls, CarriesMessagesOfEverySizeInOrder) {
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  std::vector<std::string> sent;
  for (const std::size_t size : {0, 1, 16'384, 131'064, 262'128, 1'000'000, 8'388'608}) {
    sent.emplace_back(size, static_cast<char>('a' + sent.size()));
    ASSERT_EQ(publisher->publish(text_message(sent.back())), PublishStatus::accepted);
  }
  for (int i = 0; i < 500; ++i) {
    sent.push_back(std::to_string(i));
    publisher->publish(text_message(sent.back()));
  }
  ASSERT_TRUE(inbox.wait_for(sent.size()));
  EXPECT_TRUE(inbox.bodies() == sent);
  EXPECT_TRUE(publisher->drain(patience));
}

TEST_F(RabbitMqTls, ABurstFromTheServerIsReadToItsEnd) {
  const auto sender = make_broker(options());
  const auto reader = make_broker(options());
  Inbox inbox;
  SubscriptionOptions one_by_one;
  one_by_one.prefetch = 1;  // the server sends the next one only after what came was settled
  const auto subscription = reader->subscribe(topic(), one_by_one, inbox.handler());
  const auto publisher = sender->publisher(topic(), {});
  for (int i = 0; i < 300; ++i) {
    ASSERT_EQ(publisher->publish(text_message(std::string(static_cast<std::size_t>(i) * 97, 'x'))),
              PublishStatus::accepted);
  }
  EXPECT_TRUE(inbox.wait_for(300));
}

TEST_F(RabbitMqTls, LosesNothingWhenTheServerIsKilled) {
  const auto broker = make_broker(options());
  Topic topic = this->topic();
  topic.durable = true;
  topic.exchange = "tls_durable";
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  server_->kill();
  publisher->publish(text_message("2"));
  server_->start();
  ASSERT_TRUE(inbox.wait_until([](const auto& received) { return received.back().body == "2"; }));
}

TEST_F(RabbitMqTls, APasswordMayComeFromTheEnvironment) {
  BrokerOptions from_environment = options();
  from_environment.password_file.clear();
  from_environment.password_variable = "IOTCLOUD_TEST_PASSWORD";
  ::setenv("IOTCLOUD_TEST_PASSWORD", tests::server_password, 1);
  const auto broker = make_broker(from_environment);
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }));
}

TEST_F(RabbitMqTls, APasswordThatChangesIsTakenAtTheNextConnection) {
  const BrokerOptions late = options();
  std::filesystem::remove(late.password_file);
  const auto broker = make_broker(late);
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("x"));
  EXPECT_FALSE(eventually([&] { return broker->state() == ConnectionState::connected; }, moment));
  std::ofstream(late.password_file) << tests::server_password << "\n";
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }));
}

TEST_F(RabbitMqTls, AWrongPasswordIsSaidOnceAndNotShown) {
  BrokerOptions wrong = options();
  std::ofstream(wrong.password_file) << "hush-hush"
                                     << "\n";
  const std::string said = complaint(wrong);
  EXPECT_THAT(said, testing::HasSubstr("ACCESS_REFUSED"));
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
  EXPECT_THAT(said, testing::Not(testing::HasSubstr("hush-hush")));
}

TEST_F(RabbitMqTls, AnAuthorityThatDidNotSignTheServersCertificateIsSaidOnce) {
  BrokerOptions wrong = options();
  wrong.tls.ca_file = file("client.pem");
  const std::string said = complaint(wrong);
  EXPECT_THAT(said, testing::HasSubstr("certificate"));
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
}

TEST_F(RabbitMqTls, WithoutAFileTheSystemsAuthoritiesAreAsked) {
  BrokerOptions wrong = options();
  wrong.tls.ca_file.clear();
  EXPECT_THAT(complaint(wrong), testing::HasSubstr("certificate"));
}

TEST_F(RabbitMqTls, AHostNameThatIsNotInTheCertificateIsRefused) {
  BrokerOptions wrong = options();
  const auto at = wrong.urls.front().find("localhost");
  wrong.urls.front().replace(at, 9, "127.0.0.2");
  EXPECT_THAT(complaint(wrong), testing::HasSubstr("cannot connect"));
}

TEST_F(RabbitMqTls, AMissingClientCertificateIsSaid) {
  BrokerOptions wrong = options();
  wrong.tls.certificate_file.clear();
  wrong.tls.key_file.clear();
  const std::string said = complaint(wrong);
  EXPECT_THAT(said, testing::HasSubstr("cannot connect"));
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
}

TEST_F(RabbitMqTls, FilesThatCannotBeUsedAreNamed) {
  BrokerOptions wrong = options();
  wrong.tls.ca_file = file("no-such.pem");
  EXPECT_THAT(complaint(wrong), testing::HasSubstr("no-such.pem"));
  wrong = options();
  wrong.tls.key_file = file("ca.pem");
  EXPECT_THAT(complaint(wrong), testing::HasSubstr("client.pem"));
}

}  // namespace
}  // namespace iotcloud::brokers
