// Questions to many gateways share a few threads.
#include <atomic>
#include <future>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/master/api/gateway_asks.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::master {
namespace {

TEST(GatewayAsks, AThousandQuestionsStartNoMoreThreadsThanAllowed) {
  std::atomic<int> at_once{0}, most{0};
  GatewayAsks asks(4);
  std::vector<std::future<int>> answers;
  for (int i = 0; i < 1000; ++i) {
    answers.push_back(asks.ask([&, i] {
      const int now = ++at_once;
      for (int before = most; before < now && !most.compare_exchange_weak(before, now);) {
      }
      --at_once;
      return i;
    }));
  }
  for (int i = 0; i < 1000; ++i) EXPECT_EQ(answers[static_cast<std::size_t>(i)].get(), i);
  EXPECT_LE(most, 4);
  EXPECT_LE(asks.threads(), 4u);
}

TEST(GatewayAsks, AQuestionThatThrowsGivesItsAskerTheError) {
  GatewayAsks asks(1);
  auto failing = asks.ask([]() -> int { throw std::runtime_error("no"); });
  EXPECT_THROW(failing.get(), std::runtime_error);
  EXPECT_EQ(asks.ask([] { return 2; }).get(), 2);
}

TEST(GatewayAsks, QuestionsThatStillWaitAtTheEndAreNotAsked) {
  std::promise<void> go_on;
  std::atomic<bool> begun{false};
  std::future<void> first;
  std::future<int> second;
  std::jthread unblock;
  {
    GatewayAsks asks(1);
    first = asks.ask([&, go = go_on.get_future().share()] {
      begun = true;
      go.wait();
    });
    second = asks.ask([] { return 1; });
    ASSERT_TRUE(tests::eventually([&] { return begun.load(); }));
    unblock = std::jthread([&] { go_on.set_value(); });
  }
  EXPECT_NO_THROW(first.get());
  EXPECT_TRUE(second.valid());
}

}  // namespace
}  // namespace iotcloud::master
