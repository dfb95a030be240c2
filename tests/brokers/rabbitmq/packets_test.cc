// How messages leave: bytes that the kernel is told to hold back must be followed by more.
#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <memory>
#include <string>

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace {

std::array<std::atomic<bool>, 1024> last_said_more;  // by descriptor
std::atomic<std::size_t> sent_bytes = 0;

bool something_is_held_back() {
  return std::any_of(last_said_more.begin(), last_said_more.end(), [](const auto& said) { return said.load(); });
}

}  // namespace

/// Replaces the C library's sendmsg: does the same and records its flags.
extern "C" ssize_t sendmsg(int descriptor, const msghdr* message, int flags) {
  const ssize_t sent = ::syscall(SYS_sendmsg, descriptor, message, flags);
  if (sent > 0) {
    last_said_more.at(static_cast<std::size_t>(descriptor)) = (flags & MSG_MORE) != 0;
    sent_bytes += static_cast<std::size_t>(sent);
  }
  return sent;
}

namespace iotcloud::brokers {
namespace {

TEST(RabbitMqPackets, ALoneMessageOfAnySizeLeavesWhole) {
  const tests::PrivateServer server("rabbitmq.py");
  BrokerOptions options;
  options.urls = {server.url()};
  const auto broker = make_broker(options);
  const Topic topic{"packets", "gw.driver.whole", false};
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  const auto publisher = broker->publisher(topic, {});
  std::size_t messages = 0;
  // librabbitmq marks the last frame of a body that fills its frames with "more follows".
  constexpr std::size_t frame = 131'072 - 8;
  for (const std::size_t size : {std::size_t{100}, std::size_t{60'000}, std::size_t{65'536}, frame, frame + 1,
                                 2 * frame, std::size_t{1'000'000}}) {
    const std::size_t before = sent_bytes;
    publisher->publish(text_message(std::string(size, 'x')));
    ASSERT_TRUE(inbox.wait_for(++messages)) << size;
    // The message may be back before the thread that sent it has noted so.
    EXPECT_TRUE(eventually([&] { return sent_bytes - before >= size; }))
        << "the messages take another way: this test looks at the wrong one";
    EXPECT_TRUE(eventually([] { return !something_is_held_back(); }))
        << size << " bytes: their end waits for what may never come";
  }
}

}  // namespace
}  // namespace iotcloud::brokers
