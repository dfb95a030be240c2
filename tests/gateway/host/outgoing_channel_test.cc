// A channel on which an instance sends, with the in-process broker.
#include <filesystem>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/outgoing_channel.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/message_log.h>

namespace iotcloud::gateway {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;
using tests::eventually;
namespace fs = std::filesystem;

class OutgoingChannelTest : public ::testing::Test {
 protected:
  OutgoingChannelTest() : url_(std::string("embedded://") + name()), server_(brokers::embedded::Server::named(name())) {
    std::string pattern = fs::temp_directory_path() / "iotcloud-outgoing-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    environment_.clock = &config::system_clock();
    environment_.metrics = &metrics_;
    environment_.brokers = std::make_unique<brokers::BrokerPool>(nullptr, &metrics_);
    plan_.spec.name = "data";
    plan_.spec.capacity = 1;
    plan_.topic = {"", "gw.probe.1.data", true};
    plan_.address = {"embedded", {url_}};
    plan_.record.name = "data";
    plan_.record.driver = "probe"_driver;
  }
  ~OutgoingChannelTest() override { fs::remove_all(folder_); }

  static std::string name() { return ::testing::UnitTest::GetInstance()->current_test_info()->name(); }
  static drivers::Message message(const std::string& text) {
    drivers::Message message;
    message.payload = brokers::Payload::copy(text);
    return message;
  }
  OutgoingChannel open() {
    return OutgoingChannel(environment_, "1"_instance, plan_,
                           {[this] { ++writable_; }, [this](std::uint64_t number) { stored_ = number; }});
  }
  double count(const std::string& outcome) {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      const auto found = sample.labels.find("outcome");
      if (sample.name == "iotcloud_driver_messages_total" && found != sample.labels.end() && found->second == outcome)
        sum += sample.value;
    }
    return sum;
  }

  std::string url_;
  brokers::embedded::Server server_;
  fs::path folder_;
  config::Metrics metrics_;
  HostEnvironment environment_;
  PlannedChannel plan_;
  std::atomic<int> writable_{0};
  std::atomic<std::uint64_t> stored_{0};
};

TEST_F(OutgoingChannelTest, WhatTheBrokerHasConfirmedIsCountedSo) {
  MessageLog reader(url_, plan_.topic);
  auto channel = open();
  EXPECT_EQ(channel.publish(message("a")), drivers::PublishStatus::accepted);
  channel.drain(20s);
  EXPECT_EQ(count("confirmed"), 1);
  EXPECT_TRUE(reader.next().has_value());
}

TEST_F(OutgoingChannelTest, AFullOneSaysSoAndWhenItTakesMessagesAgain) {
  const MessageLog reader(url_, plan_.topic);  // without one nothing is confirmed
  auto channel = open();
  server_.stop();
  EXPECT_TRUE(eventually([&] { return channel.publish(message("a")) == drivers::PublishStatus::would_block; }));
  EXPECT_GE(count("would_block"), 1);
  server_.start();
  EXPECT_TRUE(eventually([&] { return writable_ > 0; }));
}

TEST_F(OutgoingChannelTest, WithoutAStateFolderNothingCanBeSpooled) {
  plan_.spec.when_full = drivers::WhenFull::spool;
  try {
    open();
    FAIL() << "it was opened";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("no state folder"));
  }
}

TEST_F(OutgoingChannelTest, WhatIsSpooledAndNotSentIsThereForTheNextOne) {
  plan_.spec.when_full = drivers::WhenFull::spool;
  environment_.state_folder = folder_;
  server_.stop();
  {
    auto channel = open();
    EXPECT_TRUE(channel.spooled());
    EXPECT_EQ(channel.publish(message("kept")), drivers::PublishStatus::accepted);
    EXPECT_TRUE(eventually([&] { return stored_ == 1; }));
    channel.close();
    channel.close();  // nothing more happens
  }
  EXPECT_TRUE(fs::exists(folder_ / "spool/1/data"));
  server_.start();
  MessageLog reader(url_, plan_.topic);
  auto next = open();
  EXPECT_TRUE(reader.next().has_value());
  next.drain(20s);
  next.close();
}

}  // namespace
}  // namespace iotcloud::gateway
