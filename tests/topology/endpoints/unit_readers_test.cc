// The readers of one unit, with the in-process broker.
#include <string>

#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/endpoints/receiving/unit_readers.h>

namespace iotcloud::topology {
namespace {

using tests::eventually;
using namespace std::chrono_literals;

class UnitReadersTest : public testing::Test {
 protected:
  UnitReadersTest() : server_(brokers::embedded::Server::named(name())) {
    brokers::BrokerOptions options;
    options.urls = {"embedded://" + name()};
    broker_ = brokers::make_broker(options);
  }
  static std::string name() {
    return std::string("readers-") + testing::UnitTest::GetInstance()->current_test_info()->name();
  }
  UnitReaders::Key key(const std::string& topic) const {
    return {{"local", {"embedded://" + name()}}, {"", topic, false}};
  }
  UnitReaders::Wanted wanted(const std::vector<std::string>& topics) const {
    UnitReaders::Wanted wanted;
    for (const auto& topic : topics) wanted.emplace(key(topic), &channel_);
    return wanted;
  }
  UnitReaders::Open open() {
    return [this](const discovery::ChannelRecord&, const UnitReaders::Key& at) -> std::shared_ptr<TopicReader> {
      ++opened_;
      if (at.second.name == "broken") return nullptr;
      return TopicReader::open(broker_, at.first, at.second, {}, {"gateway"_gateway, "driver"_instance}, queue_, fence_,
                               std::make_shared<HeldMessages>());
    };
  }
  void send(const std::string& topic) {
    const auto publisher = broker_->publisher(key(topic).second, {});
    brokers::Message message;
    message.payload = brokers::Payload::copy("x");
    EXPECT_EQ(publisher->publish(std::move(message)), brokers::PublishStatus::accepted);
    EXPECT_TRUE(publisher->drain(20s));
  }

  brokers::embedded::Server server_;
  std::shared_ptr<brokers::Broker> broker_;
  const std::shared_ptr<SpoutQueue> queue_ = std::make_shared<SpoutQueue>(100, SpoutWaker());
  const std::shared_ptr<StandstillFence> fence_ = std::make_shared<StandstillFence>();
  discovery::ChannelRecord channel_;
  UnitReaders::Totals totals_;
  int opened_ = 0;
};

TEST_F(UnitReadersTest, WhatIsWantedIsOpenedOnceAndWhatIsNotIsClosed) {
  UnitReaders readers(totals_);
  readers.open_missing(wanted({"a", "b"}), open());
  EXPECT_EQ(totals_.open, 2u);
  readers.keep_only(wanted({"b", "c"}));
  EXPECT_EQ(totals_.open, 1u);
  readers.open_missing(wanted({"b", "c"}), open());
  EXPECT_EQ(totals_.open, 2u);
  EXPECT_EQ(opened_, 3);
  readers.close();
  EXPECT_EQ(totals_.open, 0u);
}

TEST_F(UnitReadersTest, WhatCannotBeOpenedIsTriedAgain) {
  UnitReaders readers(totals_);
  readers.open_missing(wanted({"broken"}), open());
  readers.open_missing(wanted({"broken"}), open());
  EXPECT_EQ(totals_.open, 0u);
  EXPECT_EQ(totals_.missing, 1u);
  EXPECT_TRUE(readers.lacks_one());
  EXPECT_EQ(opened_, 2);
  readers.close();
  EXPECT_EQ(totals_.missing, 0u);
}

TEST_F(UnitReadersTest, WhatWasBroughtIsInHandUntilItIsSettled) {
  UnitReaders readers(totals_);
  readers.open_missing(wanted({"a"}), open());
  EXPECT_EQ(readers.in_hand(), 0U);
  send("a");
  ASSERT_TRUE(eventually([&] { return queue_->size() > 0; }));
  readers.drain();
  EXPECT_GT(readers.in_hand(), 0U);
  queue_->pop().arrival->delivery.settle(brokers::Settlement::accept);
  EXPECT_EQ(readers.in_hand(), 0U);
  readers.close();
}

TEST_F(UnitReadersTest, AReaderWhoseBrokerIsAwayIsCutOff) {
  UnitReaders readers(totals_);
  readers.open_missing(wanted({"a"}), open());
  EXPECT_TRUE(eventually([&] { return !readers.cut_off(); }));
  server_.stop();
  EXPECT_TRUE(eventually([&] { return readers.cut_off(); }));
  readers.close();
}

}  // namespace
}  // namespace iotcloud::topology
