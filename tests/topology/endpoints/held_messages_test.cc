// The memory that spouts may use for messages that bolts keep.
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/endpoints/receiving/held_messages.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {
namespace {

using tests::eventually;
using namespace std::chrono_literals;

TEST(HeldMessages, HaveRoomForWhatIsWithinTheLimitWithWhatIsThere) {
  HeldMessages held(1000);
  EXPECT_TRUE(held.has_room(1000));
  EXPECT_FALSE(held.has_room(1001));
  held.add(600);
  EXPECT_TRUE(held.has_room(400));
  EXPECT_FALSE(held.has_room(401));
  held.remove(600);
  EXPECT_TRUE(held.has_room(1000));
}

/// A reader of 100 messages of 100 bytes each, all of which are kept.
class KeptMessages : public testing::Test {
 protected:
  static constexpr int sent = 100;
  static constexpr std::size_t size = 100;

  /// Reads with a prefetch of 4, and so much memory, until the reader has brought so many messages.
  /// \return its prefetch then; 0: fewer messages came
  std::size_t prefetch_with(std::size_t most_bytes, std::size_t brought) {
    const std::string name = std::string("held-") + testing::UnitTest::GetInstance()->current_test_info()->name();
    const auto server = brokers::embedded::Server::named(name);
    const brokers::Topic topic{"", "t", false};
    brokers::BrokerOptions to;
    to.urls = {"embedded://" + name};
    const std::shared_ptr<brokers::Broker> broker = brokers::make_broker(to);
    brokers::SubscriptionOptions options;
    options.prefetch = 4;
    options.prefetch_limit = 1000;
    const auto queue = std::make_shared<SpoutQueue>(sent, SpoutWaker());
    const auto reader =
        TopicReader::open(broker, {"local", to.urls}, topic, options, {}, queue, std::make_shared<StandstillFence>(),
                          std::make_shared<HeldMessages>(most_bytes));
    const auto publisher = broker->publisher(topic, {});
    for (int i = 0; i < sent; ++i) {
      brokers::Message message;
      message.payload = brokers::Payload::copy(std::string(size, 'x'));
      EXPECT_EQ(publisher->publish(std::move(message)), brokers::PublishStatus::accepted);
    }
    std::vector<ChannelMessage> kept;
    const bool came = eventually([&] {
      for (auto taken = queue->pop(); taken.arrival; taken = queue->pop()) kept.push_back(std::move(*taken.arrival));
      return kept.size() == brought;
    });
    const std::size_t prefetch = reader->prefetch();
    reader->close();
    return came ? prefetch : 0;
  }
};

TEST_F(KeptMessages, RaiseThePrefetchUntilAllAreHere) {
  EXPECT_GE(prefetch_with(HeldMessages::usual_limit, sent), std::size_t{sent});
}

TEST_F(KeptMessages, RaiseItOnlyAsFarAsTheMemoryForThemGoes) {
  // With 4 here, 8 need 800 bytes at most; with 4 of those 8 here, 16 would need 1200 at least.
  EXPECT_EQ(prefetch_with(1000, 8), 8U);
}

}  // namespace
}  // namespace iotcloud::topology
