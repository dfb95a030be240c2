// A real Kafka that refuses messages for a while.
#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class KafkaPermission : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("kafka.py", {"--acls"}); }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }

  static std::unique_ptr<Broker> broker() {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.heartbeat = std::chrono::seconds(2);
    return make_broker(options);
  }
  static Topic topic() {
    return {"", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), false};
  }
  static tests::PrivateServer* server_;
};

tests::PrivateServer* KafkaPermission::server_ = nullptr;

TEST_F(KafkaPermission, ThatIsMissingForAWhileLosesNothing) {
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  server_->command("forbid", "FORBIDDEN");
  {
    const tests::CapturedLog log;
    for (const auto& body : numbered(11, 30)) publisher->publish(text_message(body));
    ASSERT_TRUE(eventually([&] { return log.contains("refuses messages for topic " + topic().name); }, patience));
  }
  EXPECT_FALSE(publisher->drain(moment)) << "the server takes nothing";
  EXPECT_EQ(outcomes.size(), 10U) << "and nothing is given up";
  server_->command("permit", "PERMITTED");
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 30U);
  ASSERT_TRUE(inbox.wait_for(30));
  EXPECT_EQ(inbox.bodies(), numbered(1, 30));
}

}  // namespace
}  // namespace iotcloud::brokers
