// A link and the loop that serves it, without a server.
#include <atomic>
#include <string>
#include <vector>

#include <gtest/gtest.h>

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
  IoLoop loop(config::system_clock());
  config::Mutex mutex;
  CountingLink link(mutex, loop, options, urls, "test", log);
  loop.start({&link});
  link.wake_loop();
  loop.wake();  // it looks again, and then sleeps
  ASSERT_TRUE(tests::eventually([&] { return link.looks() > 1; }));
  link.start();
  EXPECT_TRUE(tests::eventually([&] { return link.worked(); }));
  link.close();
  loop.stop();
}

}  // namespace
}  // namespace iotcloud::brokers::activemq
