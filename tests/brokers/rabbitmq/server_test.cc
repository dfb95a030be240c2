// Behaviour that needs a real RabbitMQ server: alarms, hanging, objects deleted or made by others.
#include <algorithm>
#include <filesystem>
#include <future>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/captured_log.h"
#include <iotcloud/brokers/spool/spooled_publisher.h>

namespace iotcloud::brokers {
namespace {

std::span<const std::byte> as_bytes(std::string_view literal) {
  return std::as_bytes(std::span(literal));
}

class RabbitMqServer : public BrokerContract {
 protected:
  /// A separate client, which acts as an operator or a foreign program.
  std::unique_ptr<rabbitmq::AmqpLink> operator_link() const {
    rabbitmq::AmqpLinkOptions options;
    options.url = parse_broker_url(server().url());
    options.purpose = "test";
    options.rpc_timeout = patience;
    auto link = std::make_unique<rabbitmq::AmqpLink>(options);
    link->open_channel(1);
    return link;
  }
  /// Sends a method and waits for any answer.
  template <typename Method>
  static void call(rabbitmq::AmqpLink& link, amqp_method_number_t number, Method method) {
    link.send(1, number, method);
    ASSERT_TRUE(eventually([&] { return link.next_frame().has_value(); }));
  }
  /// Makes the queue of a durable topic, which stays.
  static void make_queue(Broker& broker, const Topic& topic) {
    Inbox nobody;
    await_active(*broker.subscribe(topic, {}, nobody.handler()));
  }
  bool has_queue(const std::string& name) const {
    const auto link = operator_link();
    amqp_queue_declare_t request{};
    request.queue = rabbitmq::to_bytes(name);
    request.passive = 1;
    link->send(1, AMQP_QUEUE_DECLARE_METHOD, request);
    std::optional<amqp_frame_t> answer;
    EXPECT_TRUE(eventually([&] { return (answer = link->next_frame()).has_value(); }));
    return answer && answer->payload.method.id == AMQP_QUEUE_DECLARE_OK_METHOD;
  }
};

INSTANTIATE_TEST_SUITE_P(On, RabbitMqServer, testing::Values("rabbitmq"), [](const auto& kind) { return kind.param; });

TEST_P(RabbitMqServer, AnAlarmBlocksPublishingAndLosesNothing) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  PublisherOptions options;
  options.capacity = 300;
  const auto publisher = broker->publisher(topic, options);
  publish_numbers(*publisher, 1, 10);
  ASSERT_TRUE(inbox.wait_for(10));
  server().process()->command("alarm", "ALARM");
  publish_numbers(*publisher, 11, 200);
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::blocked; }));
  EXPECT_FALSE(publisher->drain(moment));
  EXPECT_EQ(publisher->publish(Message{Payload::copy(std::string(2'000'000, 'x')), "", "", 0, {}}),
            PublishStatus::accepted)
      << "publish must not block";
  server().process()->command("clear", "CLEAR");
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_for(201));
  for (int i = 0; i < 200; ++i) EXPECT_EQ(inbox.bodies()[i], std::to_string(i + 1));
  EXPECT_EQ(broker->state(), ConnectionState::connected);
}

TEST_P(RabbitMqServer, APermissionThatIsMissingForAWhileLosesNothing) {
  const auto reader = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = reader->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto broker = this->broker();
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  server().process()->command("forbid", "FORBIDDEN");
  {
    const tests::CapturedLog log;
    publish_numbers(*publisher, 1, 20);
    ASSERT_TRUE(eventually([&] { return log.contains("refuses messages for topic " + topic.name); }));
  }
  EXPECT_FALSE(publisher->drain(moment)) << "the server takes nothing";
  EXPECT_EQ(outcomes.size(), 0U) << "and nothing is given up";
  server().process()->command("permit", "PERMITTED");
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 20U);
  ASSERT_TRUE(inbox.wait_for(20));
  EXPECT_EQ(inbox.bodies(), numbered(1, 20));
}

/// A publisher with a spool in a folder of its own, which is removed at the end.
class SpoolToServer {
 public:
  SpoolToServer(Broker& broker, const Topic& topic) {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-refused-spool-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    SpoolOptions spool;
    spool.folder = folder_ / "spool";
    PublisherOptions options;
    options.on_outcome = outcomes.callback();
    publisher = make_spooled_publisher(broker, topic, options, spool);
  }
  ~SpoolToServer() {
    publisher.reset();
    std::filesystem::remove_all(folder_);
  }
  SpoolToServer(const SpoolToServer&) = delete;
  SpoolToServer& operator=(const SpoolToServer&) = delete;

  Outcomes outcomes;
  std::unique_ptr<Publisher> publisher;

 private:
  std::filesystem::path folder_;
};

TEST_P(RabbitMqServer, APermissionThatIsMissingForAWhileEmptiesNoSpool) {
  const auto reader = this->broker();
  const Topic topic = this->topic(true);
  Inbox inbox;
  const auto subscription = reader->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto broker = this->broker();
  SpoolToServer spool(*broker, topic);
  server().process()->command("forbid", "FORBIDDEN");
  {
    const tests::CapturedLog log;
    publish_numbers(*spool.publisher, 1, 2000);
    ASSERT_TRUE(eventually([&] { return log.contains("refuses messages for topic " + topic.name); }));
    EXPECT_TRUE(log.contains("403")) << log.text();
  }
  EXPECT_FALSE(spool.publisher->drain(moment)) << "the server takes nothing";
  EXPECT_EQ(spool.outcomes.count(Outcome::refused), 0U);
  server().process()->command("permit", "PERMITTED");
  publish_numbers(*spool.publisher, 2001, 2010);
  ASSERT_TRUE(spool.publisher->drain(patience));
  EXPECT_EQ(spool.outcomes.count(Outcome::confirmed), 2010U);
  EXPECT_TRUE(spool.outcomes.each_once());
  ASSERT_TRUE(inbox.wait_for_last("2010"));
  EXPECT_EQ(firsts(inbox), numbered(1, 2010));
}

TEST_P(RabbitMqServer, AVirtualHostThatMayNotBeUsedForAWhileLosesNothing) {
  const auto reader = this->broker();
  const Topic topic = this->topic(true);
  Inbox inbox;
  const auto subscription = reader->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto broker = this->broker();
  SpoolToServer spool(*broker, topic);
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const Topic other = this->topic(true);
  Inbox others;
  const auto other_subscription = reader->subscribe(other, {}, others.handler());
  await_active(*other_subscription);
  const auto publisher = broker->publisher(other, options);
  publish_numbers(*spool.publisher, 1, 10);
  publish_numbers(*publisher, 1, 10);
  ASSERT_TRUE(spool.publisher->drain(patience) && publisher->drain(patience));
  {
    const tests::CapturedLog log;
    server().process()->command("banish", "BANISHED");
    ASSERT_TRUE(eventually([&] { return log.contains("530"); })) << log.text();
    publish_numbers(*spool.publisher, 11, 500);
    publish_numbers(*publisher, 11, 500);
    EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting; }));
  }
  EXPECT_EQ(spool.outcomes.count(Outcome::refused) + outcomes.count(Outcome::refused), 0U);
  server().process()->command("permit", "PERMITTED");
  ASSERT_TRUE(spool.publisher->drain(patience) && publisher->drain(patience));
  EXPECT_EQ(spool.outcomes.count(Outcome::confirmed), 500U);
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 500U);
  ASSERT_TRUE(inbox.wait_for_last("500") && others.wait_for_last("500"));
  EXPECT_EQ(firsts(inbox), numbered(1, 500));
  EXPECT_EQ(firsts(others), numbered(1, 500));
}

TEST_P(RabbitMqServer, AQueueThatTakesNoMoreMessagesLosesNothing) {
  const auto reader = this->broker();
  const Topic topic = this->topic(true);
  make_queue(*reader, topic);
  server().process()->command("cap", "CAPPED");
  const auto broker = this->broker();
  SpoolToServer spool(*broker, topic);
  const Topic other = this->topic(true);
  make_queue(*reader, other);
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(other, options);
  {
    const tests::CapturedLog log;
    publish_numbers(*spool.publisher, 1, 50);
    publish_numbers(*publisher, 1, 50);
    // The server refuses at once what is too much, and confirms later what it has stored.
    EXPECT_TRUE(eventually([&] { return log.contains("(nack)"); }));
  }
  EXPECT_FALSE(publisher->drain(moment)) << "the server takes no more";
  EXPECT_FALSE(spool.publisher->drain(moment));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), outcomes.size()) << "nothing is given up";
  EXPECT_EQ(spool.outcomes.count(Outcome::confirmed), spool.outcomes.size());
  Inbox inbox, others;
  const auto subscription = reader->subscribe(topic, {}, inbox.handler());
  const auto other_subscription = reader->subscribe(other, {}, others.handler());
  ASSERT_TRUE(publisher->drain(patience) && spool.publisher->drain(patience));
  server().process()->command("uncap", "UNCAPPED");
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 50U);
  EXPECT_EQ(spool.outcomes.count(Outcome::confirmed), 50U);
  ASSERT_TRUE(inbox.wait_for_last("50") && others.wait_for_last("50"));
  EXPECT_EQ(firsts(inbox), numbered(1, 50));
  EXPECT_EQ(firsts(others), numbered(1, 50));
}

TEST_P(RabbitMqServer, AServerThatHangsIsNoticedAndNothingIsLost) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  publish_numbers(*publisher, 1, 10);
  ASSERT_TRUE(inbox.wait_for(10));
  server().process()->pause();
  publish_numbers(*publisher, 11, 50);
  // Far more than the socket holds: now some thread blocks in a send, but not this one.
  for (int i = 0; i < 20; ++i) publisher->publish(text_message(std::string(2'000'000, 'x')));
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting && !subscription->active(); }));
  server().process()->resume();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_until([](const auto& received) {
    return std::count_if(received.begin(), received.end(), [](const auto& one) { return one.body.size() > 100; }) >= 20;
  }));
  std::vector<int> firsts;
  for (const std::string& body : inbox.bodies()) {
    if (body.size() > 100) continue;
    const int number = std::stoi(body);
    if (std::find(firsts.begin(), firsts.end(), number) == firsts.end()) firsts.push_back(number);
  }
  EXPECT_EQ(firsts.size(), 50U);
  EXPECT_TRUE(std::is_sorted(firsts.begin(), firsts.end()));
}

TEST_P(RabbitMqServer, AClientThatComesWhileTheServerHangsGetsInWhenItIsBack) {
  server().process()->pause();
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publish_numbers(*publisher, 1, 5);
  EXPECT_EQ(broker->state(), ConnectionState::connecting);
  EXPECT_FALSE(publisher->drain(moment));
  server().process()->resume();
  ASSERT_TRUE(inbox.wait_for(5));
  EXPECT_EQ(inbox.bodies(), numbered(1, 5));
}

TEST_P(RabbitMqServer, APublisherThatIsQuietOrOnlyPublishesKeepsItsConnection) {
  const auto reader = this->broker();
  const auto sender = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = reader->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto publisher = sender->publisher(topic, {});
  publish_numbers(*publisher, 1, 1);
  ASSERT_TRUE(publisher->drain(patience));
  const auto left = [&] { return sender->state() != ConnectionState::connected; };
  EXPECT_FALSE(eventually(left, given_up_after)) << "quiet";
  int last = 1;
  EXPECT_FALSE(eventually(
      [&] {
        if (publisher->pending() == 0) {
          ++last;
          publish_numbers(*publisher, last, last);
        }
        return left();
      },
      given_up_after))
      << "publishing";
  ASSERT_TRUE(inbox.wait_for(static_cast<std::size_t>(last)));
  for (const auto& received : inbox.all()) EXPECT_FALSE(received.redelivered) << received.body;
}

TEST_P(RabbitMqServer, ThePrefetchOfADurableTopicIsRaisedUnlessItsQueueIsAQuorumQueue) {
  for (const std::string type : {"classic", "quorum"}) {
    BrokerOptions connection;
    connection.urls = {server().url()};
    connection.properties["queue_type"] = type;
    const auto broker = make_broker(connection);
    Topic topic = this->topic();
    topic.name += type;
    topic.exchange.clear();  // the tests' own exchange is not durable
    topic.durable = true;
    Holder holder;
    SubscriptionOptions options;
    options.prefetch = 5;
    options.prefetch_limit = 40;
    const auto subscription = broker->subscribe(topic, options, holder.handler());
    const auto publisher = broker->publisher(topic, {});
    publish_numbers(*publisher, 1, 30);
    ASSERT_TRUE(holder.wait_for(5));
    EXPECT_EQ(subscription->raise_prefetch(20), type == "classic");
    if (type == "classic") {
      ASSERT_TRUE(holder.wait_for(20));
    }
    EXPECT_FALSE(holder.wait_for(type == "classic" ? 21 : 6, moment));
    holder.drop_all();
  }
}

TEST_P(RabbitMqServer, AnExchangeThatIsDeletedIsDeclaredAgain) {
  const auto broker = this->broker();
  Topic topic = this->topic();
  topic.exchange = "deleted_" + topic.name;
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  publish_numbers(*publisher, 1, 5);
  ASSERT_TRUE(inbox.wait_for(5));
  ASSERT_TRUE(publisher->drain(patience));
  const auto link = operator_link();
  amqp_exchange_delete_t request{};
  request.exchange = rabbitmq::to_bytes(topic.exchange);
  call(*link, AMQP_EXCHANGE_DELETE_METHOD, request);
  publish_numbers(*publisher, 6, 10);
  EXPECT_FALSE(outcomes.wait_for(10, moment)) << "the binding is gone with the exchange: nobody reads";
  EXPECT_EQ(outcomes.size(), 5U) << "nothing was refused";
  Inbox other;
  SubscriptionOptions group;
  group.group = "other";
  const auto late = broker->subscribe(topic, group, other.handler());
  ASSERT_TRUE(other.wait_for(5));
  EXPECT_THAT(other.bodies(), testing::ElementsAre("6", "7", "8", "9", "10"));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 10U);
}

TEST_P(RabbitMqServer, AQueueThatIsDeletedUnderItsReaderIsMadeAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  publish_numbers(*publisher, 1, 1);
  ASSERT_TRUE(inbox.wait_for(1));
  const auto link = operator_link();
  amqp_queue_delete_t request{};
  request.queue = rabbitmq::to_bytes(topic.name);
  call(*link, AMQP_QUEUE_DELETE_METHOD, request);
  publish_numbers(*publisher, 2, 5);
  ASSERT_TRUE(inbox.wait_for(5));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("1", "2", "3", "4", "5"));
}

TEST_P(RabbitMqServer, AQueueThatNobodyNeedsIsRemovedUnlessItHasMessagesOrAReader) {
  const Topic empty = this->topic(true);
  const Topic unread = this->topic(true);
  const Topic unsettled = this->topic(true);
  const Topic read = this->topic(true);
  const auto other = this->broker();
  Inbox inbox;
  const auto reader = other->subscribe(read, {}, inbox.handler());
  await_active(*reader);
  {
    const auto broker = this->broker();
    for (const Topic* topic : {&empty, &unread}) await_active(*broker->subscribe(*topic, {}, inbox.handler()));
    std::promise<void> came;
    std::optional<Delivery> in_hand;
    auto subscription = broker->subscribe(unsettled, {}, [&](Delivery delivery) {
      in_hand = std::move(delivery);
      came.set_value();
    });
    await_active(*subscription);
    for (const Topic* topic : {&unread, &unsettled}) {
      const auto publisher = broker->publisher(*topic, {});
      publish_numbers(*publisher, 1, 1);
      ASSERT_TRUE(publisher->drain(patience));
    }
    ASSERT_EQ(came.get_future().wait_for(patience), std::future_status::ready);
    subscription.reset();
    // At once: the server may still count the subscription.
    for (const Topic* topic : {&empty, &unread, &unsettled, &read}) broker->remove_queue(*topic, "");
  }  // waits for all four
  EXPECT_FALSE(has_queue(empty.name));
  EXPECT_TRUE(has_queue(read.name));
  const auto broker = this->broker();
  for (const Topic* topic : {&unread, &unsettled}) {
    Inbox late;
    const auto subscription = broker->subscribe(*topic, {}, late.handler());
    ASSERT_TRUE(late.wait_for(1)) << topic->name;
    EXPECT_THAT(late.bodies(), testing::ElementsAre("1"));
  }
}

TEST_P(RabbitMqServer, AMessageThatComesAfterTheRemovalOfItsQueueWaitsForTheNextReader) {
  const Topic topic = this->topic(true);
  const auto sender = this->broker();
  const auto publisher = sender->publisher(topic, {});
  {
    const auto broker = this->broker();
    Inbox inbox;
    auto subscription = broker->subscribe(topic, {}, inbox.handler());
    await_active(*subscription);
    subscription.reset();
    broker->remove_queue(topic, "");
  }
  ASSERT_FALSE(has_queue(topic.name));
  publish_numbers(*publisher, 1, 3);
  Inbox inbox;
  const auto subscription = sender->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("1", "2", "3"));
}

TEST_P(RabbitMqServer, ATopicsOwnQueueThatIsDeletedIsMadeAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic(true);
  Outcomes outcomes;
  PublisherOptions options;
  options.own_queue = true;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  publish_numbers(*publisher, 1, 3);
  ASSERT_TRUE(publisher->drain(patience));
  const auto link = operator_link();
  amqp_queue_delete_t request{};
  request.queue = rabbitmq::to_bytes(topic.name);
  call(*link, AMQP_QUEUE_DELETE_METHOD, request);
  publish_numbers(*publisher, 4, 6);
  ASSERT_TRUE(publisher->drain(patience)) << "nobody reads, and nothing keeps it";
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 6U);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("4", "5", "6"));
}

TEST_P(RabbitMqServer, AQueueForTheOriginalIsDeclaredAsItsProgramsDeclareIt) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  const auto can_be_declared = [&](const std::string& queue) {
    const auto link = operator_link();
    amqp_queue_declare_t request{};
    request.queue = rabbitmq::to_bytes(queue);
    request.auto_delete = 1;
    link->send(1, AMQP_QUEUE_DECLARE_METHOD, request);
    std::optional<amqp_frame_t> answer;
    EXPECT_TRUE(eventually([&] { return (answer = link->next_frame()).has_value(); }));
    return answer && answer->payload.method.id == AMQP_QUEUE_DECLARE_OK_METHOD;
  };
  PublisherOptions to;
  to.own_queue = true;
  to.original_queue = topic.name + ".out";
  const auto publisher = broker->publisher(topic, to);
  publish_numbers(*publisher, 1, 3);
  ASSERT_TRUE(publisher->drain(patience)) << "nobody reads, and nothing keeps it";
  EXPECT_TRUE(can_be_declared(to.original_queue));

  SubscriptionOptions from;
  from.original_queue = topic.name + ".in";
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, from, inbox.handler());
  await_active(*subscription);
  EXPECT_TRUE(can_be_declared(from.original_queue));
  publish_numbers(*publisher, 4, 6);
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("4", "5", "6"));
}

TEST_P(RabbitMqServer, AMessageWithMoreHeadersThanAnyHonestOneIsSkippedAndCounted) {
  config::Metrics& metrics = config::process_metrics();
  const auto skipped = [&] {
    return metrics.counter("iotcloud_broker_skipped_total", "", {{"broker", "rabbitmq"}, {"reason", "undecodable"}})
        .value();
  };
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto link = operator_link();
  std::vector<std::string> names = numbered(1, 8000);
  std::vector<amqp_table_entry_t> headers(names.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    headers[i].key = rabbitmq::to_bytes(names[i]);
    headers[i].value.kind = AMQP_FIELD_KIND_BOOLEAN;
  }
  amqp_basic_properties_t properties{};
  properties._flags = AMQP_BASIC_HEADERS_FLAG;
  properties.headers = {static_cast<int>(headers.size()), headers.data()};
  const auto before = skipped();
  link->publish(1, topic.exchange, topic.name, properties, as_bytes("hostile"));
  amqp_basic_properties_t none{};
  link->publish(1, topic.exchange, topic.name, none, as_bytes("honest"));
  link->flush(false);
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("honest"));
  EXPECT_EQ(skipped(), before + 1);
}

TEST_P(RabbitMqServer, UsesExchangesAndQueuesThatOthersMadeDifferently) {
  const auto broker = this->broker();
  Topic topic = this->topic();
  topic.exchange = "others_" + topic.name;
  const auto link = operator_link();
  amqp_exchange_declare_t exchange{};
  exchange.exchange = rabbitmq::to_bytes(topic.exchange);
  exchange.type = amqp_cstring_bytes("direct");
  exchange.durable = 1;
  call(*link, AMQP_EXCHANGE_DECLARE_METHOD, exchange);
  amqp_queue_declare_t queue{};
  queue.queue = rabbitmq::to_bytes(topic.name);
  call(*link, AMQP_QUEUE_DECLARE_METHOD, queue);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publish_numbers(*publisher, 1, 3);
  ASSERT_TRUE(inbox.wait_for(3));
}

TEST_P(RabbitMqServer, TakesMessagesOfForeignProgramsWithOddHeaders) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  const auto link = operator_link();
  std::vector<amqp_table_entry_t> headers(3);
  headers[0].key = amqp_cstring_bytes("time");
  headers[0].value.kind = AMQP_FIELD_KIND_I64;
  headers[0].value.value.i64 = 77;
  headers[1].key = amqp_cstring_bytes("nested");
  headers[1].value.kind = AMQP_FIELD_KIND_TABLE;
  headers[2].key = amqp_cstring_bytes("flag");
  headers[2].value.kind = AMQP_FIELD_KIND_BOOLEAN;
  amqp_basic_properties_t properties{};
  properties._flags = AMQP_BASIC_HEADERS_FLAG;
  properties.headers = {static_cast<int>(headers.size()), headers.data()};
  link->publish(1, topic.exchange, topic.name, properties, as_bytes("odd"));
  amqp_basic_properties_t none{};
  link->publish(1, topic.exchange, topic.name, none, as_bytes("bare"));
  link->flush(false);
  ASSERT_TRUE(inbox.wait_for(2));
  const auto all = inbox.all();
  EXPECT_EQ(all[0].body, "odd");
  EXPECT_EQ(all[0].message.time_ms, 77);
  EXPECT_EQ(*all[0].message.properties.find("flag"), "false");
  EXPECT_EQ(all[0].message.properties.find("nested"), nullptr);
  EXPECT_EQ(all[1].body, "bare");
  EXPECT_EQ(all[1].message.driver_id, "");
}

TEST_P(RabbitMqServer, AWrongPasswordIsNoReasonToStop) {
  BrokerOptions options;
  options.urls = {server().url()};
  options.urls.front().replace(options.urls.front().find("guest@"), 5, "wrong");
  const auto broker = make_broker(options);
  const auto publisher = broker->publisher(topic(), {});
  EXPECT_EQ(publisher->publish(text_message("x")), PublishStatus::accepted);
  EXPECT_FALSE(publisher->drain(moment));
  EXPECT_EQ(broker->state(), ConnectionState::connecting);
}

}  // namespace
}  // namespace iotcloud::brokers
