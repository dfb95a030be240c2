// Peers that break AMQP's rules: no thread ends, and valid messages still pass.
#include <algorithm>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/brokers/tampering_proxy.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {
namespace {

std::uint16_t port_of(const std::string& url) {
  return static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1)));
}

class ActiveMqHostile : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = std::make_unique<tests::PrivateServer>("activemq.py"); }
  static void TearDownTestSuite() { server_.reset(); }

  std::unique_ptr<Broker> broker_at(const std::string& url) {
    BrokerOptions options;
    options.urls = {url};
    options.metrics = &metrics_;
    return make_broker(options);
  }
  std::unique_ptr<Broker> broker_behind_proxy() {
    return broker_at("activemq://127.0.0.1:" + std::to_string(proxy_.port()));
  }
  static Topic topic() {
    return {"", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), true};
  }
  double undecodable() {
    return static_cast<double>(
        metrics_.counter("iotcloud_broker_skipped_total", "", {{"broker", "activemq"}, {"reason", "undecodable"}})
            .value());
  }

  static std::unique_ptr<tests::PrivateServer> server_;
  config::Metrics metrics_;
  tests::TamperingProxy proxy_{port_of(server_->url())};
};

std::unique_ptr<tests::PrivateServer> ActiveMqHostile::server_;

TEST_F(ActiveMqHostile, AMessageThatIsIllFormedIsRejectedCountedAndLoggedOnceAndTheConnectionGoesOn) {
  // The length of a property goes beyond the message's end.
  proxy_.replace(std::string("\xa1\x09tamper-me", 11), std::string("\xa1\xfftamper-me", 11));
  const auto reading = broker_behind_proxy();
  const auto sending = broker_at(server_->url());
  Inbox inbox;
  const auto subscription = reading->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  const int connections = proxy_.connections();
  const auto publisher = sending->publisher(topic(), {});
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  std::vector<std::string> good;
  for (int i = 0; i < 30; ++i) {
    Message message = text_message(std::to_string(i));
    if (i % 3 == 1) {
      message.properties.set("word", "tamper-me");
    } else {
      good.push_back(std::to_string(i));
    }
    publisher->publish(message);
  }
  const bool all = inbox.wait_for(good.size()) && eventually([&] { return undecodable() >= 10; });
  const std::string said = testing::internal::GetCapturedStdout() + testing::internal::GetCapturedStderr();
  ASSERT_TRUE(all);
  EXPECT_EQ(inbox.bodies(), good);
  EXPECT_EQ(undecodable(), 10);
  EXPECT_EQ(proxy_.connections(), connections) << "no connection was made anew";
  const auto first = said.find("are no AMQP");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("are no AMQP", first + 1), std::string::npos) << said;
}

TEST_F(ActiveMqHostile, AStreamThatIsCorruptEndsTheConnectionAndNothingIsLost) {
  const auto reading = broker_behind_proxy();
  const auto sending = broker_behind_proxy();
  Inbox inbox;
  const auto subscription = reading->subscribe(topic(), {}, inbox.handler());
  const auto publisher = sending->publisher(topic(), {});
  int sent = 0;
  for (const std::string& garbage :
       {std::string("HTTP/1.1 400 Bad Request\r\n\r\n"), std::string("\0\0\0\x08\xff\xff\xff\xff", 8),
        std::string("\0\0\0\x10\x02\0\0\0\0\x53\x14\xc0\x7f\x7f\x41\x41", 16), std::string(300, '\xff')}) {
    for (int i = 0; i < 20; ++i) publisher->publish(text_message(std::to_string(++sent)));
    ASSERT_TRUE(publisher->drain(patience));
    ASSERT_TRUE(eventually([&] { return subscription->active(); }));
    const int connections = proxy_.connections();
    proxy_.inject(garbage);
    ASSERT_TRUE(eventually([&] { return proxy_.connections() >= connections + 2; })) << "of both brokers";
  }
  publisher->publish(text_message(std::to_string(++sent)));
  ASSERT_TRUE(publisher->drain(patience));
  std::vector<std::string> first_time;
  ASSERT_TRUE(inbox.wait_for_last(std::to_string(sent)));
  for (const auto& one : inbox.all()) {
    if (std::find(first_time.begin(), first_time.end(), one.body) == first_time.end()) first_time.push_back(one.body);
  }
  EXPECT_EQ(first_time, numbered(1, sent));
}

TEST_F(ActiveMqHostile, AServerThatIsHeardIsWaitedForWhenItAnswersARequestToReadLateAndASilentOneIsLeft) {
  constexpr std::chrono::seconds rpc_timeout{8};
  BrokerOptions options;
  options.urls = {"activemq://127.0.0.1:" + std::to_string(proxy_.port())};
  options.rpc_timeout = rpc_timeout;
  options.heartbeat = std::chrono::seconds(30);
  const auto broker = make_broker(options);
  Inbox inbox;
  const auto early = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return early->active(); }));
  const int connections = proxy_.connections();

  server_->pause();
  Topic other = topic();
  other.name += ".other";
  const auto late = broker->subscribe(other, {}, inbox.handler());
  const std::string heartbeat("\0\0\0\x08\x02\0\0\0", 8);
  const auto ends_while_heard = [&] {
    proxy_.inject(heartbeat);
    return proxy_.connections() > connections || !early->active();
  };
  EXPECT_FALSE(eventually(ends_while_heard, rpc_timeout + std::chrono::seconds(2)));
  EXPECT_FALSE(late->active());

  EXPECT_TRUE(eventually([&] { return proxy_.connections() > connections; })) << "it is silent now";
  server_->resume();
  EXPECT_TRUE(eventually([&] { return early->active() && late->active(); }));
}

}  // namespace
}  // namespace iotcloud::brokers
