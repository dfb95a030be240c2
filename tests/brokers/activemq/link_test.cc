// A link and the loop that serves it, and what a server's reasons mean, without a server.
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <proton/condition.h>
#include <proton/connection.h>

#include "iotcloud/brokers/activemq/engine.h"
#include "iotcloud/brokers/activemq/server_link.h"
#include <iotcloud/config/mutex.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers::activemq {
namespace {

class CountingLink final : public ServerLink {
 public:
  using ServerLink::ServerLink;
  void wake_loop() {
    const config::MutexLock lock(mutex_);
    wake();
  }
  int looks() const { return looks_; }
  bool worked() const { return worked_; }

 private:
  Wish wish() override {
    const Wish wish = ServerLink::wish();
    ++looks_;
    return wish;
  }
  void up() override {}
  void down() override {}
  void work() override { worked_ = true; }

  std::atomic<int> looks_ = 0;
  std::atomic<bool> worked_ = false;
};

TEST(ActiveMqLink, BeginsAlthoughTheLoopLookedAtItBefore) {
  BrokerOptions options;
  options.urls = {"activemq://127.0.0.1:1"};
  const std::vector<BrokerUrl> urls{parse_broker_url(options.urls.front())};
  ConnectionLog log(options.urls.front());
  ServerTrust trust("", "");
  IoLoop loop(config::system_clock());
  config::Mutex mutex;
  CountingLink link(mutex, loop, options, urls, "test", log, trust);
  loop.start({&link});
  link.wake_loop();
  loop.wake();  // it looks again, and then sleeps
  ASSERT_TRUE(tests::eventually([&] { return link.looks() > 1; }));
  link.start();
  EXPECT_TRUE(tests::eventually([&] { return link.worked(); }));
  link.close();
  loop.stop();
}

/// Whether a message is given up that the server refused with a condition of this name; empty: with none.
bool is_given_up(const char* name) {
  const std::unique_ptr<pn_connection_t, decltype(&pn_connection_free)> owner(pn_connection(), pn_connection_free);
  pn_condition_t* const condition = pn_connection_condition(owner.get());
  if (*name != '\0') pn_condition_set_name(condition, name);
  return is_final(condition);
}

TEST(ActiveMqRefusals, OnlyWhatIsMalformedOrTooLargeIsGivenUp) {
  for (const char* name : {"amqp:decode-error", "amqp:invalid-field", "amqp:frame-size-too-small",
                           "amqp:connection:framing-error", "amqp:link:message-size-exceeded"}) {
    EXPECT_TRUE(is_given_up(name)) << name;
  }
}

TEST(ActiveMqRefusals, WhatMayPassIsTriedAgainAndSoIsWhatNobodyKnows) {
  for (const char* name :
       {"failed", "amqp:unauthorized-access", "amqp:not-found", "amqp:not-allowed", "amqp:resource-limit-exceeded",
        "amqp:resource-locked", "amqp:resource-deleted", "amqp:internal-error", "amqp:illegal-state",
        "amqp:precondition-failed", "amqp:not-implemented", "amqp:connection:forced", "amqp:link:detach-forced",
        "amqp:link:redirect", "amqp:session:window-violation", "com.example:quota", ""}) {
    EXPECT_FALSE(is_given_up(name)) << name;
  }
  EXPECT_FALSE(is_final(nullptr));
}

}  // namespace
}  // namespace iotcloud::brokers::activemq
