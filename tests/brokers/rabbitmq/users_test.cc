// What the users of docker-compose.yml may do at RabbitMQ, and what a thief of one gateway's two users tries there.
#include <array>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <amqp.h>
#include <amqp_tcp_socket.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/brokers/tampering_proxy.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

using rabbitmq::to_bytes;
using testing::HasSubstr;

constexpr const char* password = "sesame";
constexpr const char* exchange = "amq.topic";

/// RabbitMQ's definitions of the users, as deploy/cluster/cluster.py makes them, but for how many queues there may be
/// and how much each may hold.
std::string definitions(const std::string& password_of_workers = password) {
  const std::string command = std::string("/usr/bin/python3 -c 'import sys; sys.path.insert(0, \"") +
                              IOTCLOUD_TEST_SERVERS +
                              "/../../deploy/cluster\"); import cluster; "
                              "cluster.MOST_QUEUES = 60; cluster.QUEUE_LIMITS[\"max-length-bytes\"] = 32 << 20; "
                              "print(cluster.rabbitmq_users({**dict.fromkeys(cluster.RABBITMQ_USERS, \"" +
                              password + "\"), \"workers\": \"" + password_of_workers + "\"}))'";
  const std::unique_ptr<FILE, int (*)(FILE*)> output(popen(command.c_str(), "r"), pclose);
  std::string text;
  std::array<char, 4096> piece{};
  while (const auto size = fread(piece.data(), 1, piece.size(), output.get())) text.append(piece.data(), size);
  return text;
}

using Connection = std::unique_ptr<amqp_connection_state_t_, int (*)(amqp_connection_state_t)>;

/// Null: the server does not let this user in, or nobody more of it.
Connection log_in(const std::string& url, const char* user, const char* by = password) {
  const BrokerUrl at = parse_broker_url(url);
  Connection connection(amqp_new_connection(), amqp_destroy_connection);
  amqp_socket_t* const socket = amqp_tcp_socket_new(connection.get());
  EXPECT_EQ(amqp_socket_open(socket, at.host.c_str(), at.port), AMQP_STATUS_OK);
  amqp_table_entry_t hears_of_alarms{};
  hears_of_alarms.key = amqp_cstring_bytes("connection.blocked");
  hears_of_alarms.value.kind = AMQP_FIELD_KIND_BOOLEAN;
  hears_of_alarms.value.value.boolean = 1;
  amqp_table_entry_t capabilities{};
  capabilities.key = amqp_cstring_bytes("capabilities");
  capabilities.value.kind = AMQP_FIELD_KIND_TABLE;
  capabilities.value.value.table = {1, &hears_of_alarms};
  const amqp_table_t properties{1, &capabilities};
  const auto login =
      amqp_login_with_properties(connection.get(), "/", 0, 131072, 0, &properties, AMQP_SASL_METHOD_PLAIN, user, by);
  if (login.reply_type != AMQP_RESPONSE_NORMAL) connection.reset();
  return connection;
}

/// A client that may do anything that its user may, beside what ours does. The server closes its channel for what is
/// not allowed, so each attempt has its own.
class Attempts {
 public:
  using Arguments = std::vector<std::pair<std::string, std::string>>;
  Attempts(const std::string& url, const char* user) : held_(log_in(url, user)), connection_(held_.get()) {
    if (!held_) throw std::runtime_error(std::string("the server does not let in ") + user);
  }

  bool is_open() {
    amqp_channel_open(connection_, ++channel_);
    return outcome() == "ok";
  }
  /// What the server says to each: "ok", or why not.
  std::string declare(const std::string& queue, const Arguments& arguments = {}, bool exclusive = false) {
    open();
    auto table = as_table(arguments);
    amqp_queue_declare(connection_, channel_, to_bytes(queue), 0, 0, exclusive ? 1 : 0, 0,
                       {static_cast<int>(table.size()), table.data()});
    return outcome();
  }
  /// A queue of which the server keeps on its disk what is to be kept.
  std::string declare_durable(const std::string& queue) {
    open();
    amqp_queue_declare(connection_, channel_, to_bytes(queue), 0, 1, 0, 0, amqp_empty_table);
    return outcome();
  }
  std::string declare_exchange(const std::string& name, const Arguments& arguments = {}) {
    open();
    auto table = as_table(arguments);
    amqp_exchange_declare(connection_, channel_, to_bytes(name), amqp_cstring_bytes("fanout"), 0, 0, 0, 0,
                          {static_cast<int>(table.size()), table.data()});
    return outcome();
  }
  std::string bind(const std::string& queue, const std::string& from, const std::string& key) {
    open();
    amqp_queue_bind(connection_, channel_, to_bytes(queue), to_bytes(from), to_bytes(key), amqp_empty_table);
    return outcome();
  }
  std::string bind_exchange(const std::string& to, const std::string& from, const std::string& key) {
    open();
    amqp_exchange_bind(connection_, channel_, to_bytes(to), to_bytes(from), to_bytes(key), amqp_empty_table);
    return outcome();
  }
  /// Deletes a queue. How many messages it had; -1: it may not.
  int remove(const std::string& queue) {
    open();
    const auto* const removed = amqp_queue_delete(connection_, channel_, to_bytes(queue), 0, 0);
    return outcome() == "ok" && removed != nullptr ? static_cast<int>(removed->message_count) : -1;
  }
  /// "full": a queue takes no more; "blocked": the server takes nothing from anybody.
  std::string publish(const std::string& to, const std::string& key, const std::string& body = "forged",
                      bool kept = false) {
    open();
    amqp_confirm_select(connection_, channel_);
    EXPECT_EQ(outcome(), "ok");
    amqp_basic_properties_t properties{};
    properties._flags = kept ? AMQP_BASIC_DELIVERY_MODE_FLAG : 0;
    properties.delivery_mode = AMQP_DELIVERY_PERSISTENT;
    amqp_basic_publish(connection_, channel_, to_bytes(to), to_bytes(key), 0, 0, &properties, to_bytes(body));
    amqp_frame_t answer{};
    while (amqp_simple_wait_frame(connection_, &answer) == AMQP_STATUS_OK) {
      if (answer.frame_type == AMQP_FRAME_METHOD && answer.payload.method.id == AMQP_CONNECTION_BLOCKED_METHOD)
        return "blocked";
      if (answer.frame_type != AMQP_FRAME_METHOD || answer.channel != channel_) continue;
      if (answer.payload.method.id == AMQP_BASIC_ACK_METHOD) return "ok";
      if (answer.payload.method.id == AMQP_BASIC_NACK_METHOD) return "full";
      if (answer.payload.method.id == AMQP_CHANNEL_CLOSE_METHOD) return closed(answer.payload.method.decoded);
    }
    return "the connection broke";
  }
  std::string consume(const std::string& queue) {
    open();
    amqp_basic_consume(connection_, channel_, to_bytes(queue), amqp_empty_bytes, 0, 1, 0, amqp_empty_table);
    return outcome();
  }
  /// Reads a queue from now on, and acknowledges nothing.
  std::string hold(const std::string& queue) {
    open();
    amqp_basic_consume(connection_, channel_, to_bytes(queue), amqp_empty_bytes, 0, 0, 0, amqp_empty_table);
    return outcome();
  }
  /// Waits for a message of what it reads.
  bool takes_one() {
    amqp_envelope_t message{};
    amqp_maybe_release_buffers(connection_);
    const timeval limit{60, 0};
    const bool came = amqp_consume_message(connection_, &message, &limit, 0).reply_type == AMQP_RESPONSE_NORMAL;
    if (came) amqp_destroy_envelope(&message);
    return came;
  }

 private:
  static std::vector<amqp_table_entry_t> as_table(const Arguments& arguments) {
    std::vector<amqp_table_entry_t> table(arguments.size());
    for (std::size_t i = 0; i < arguments.size(); ++i) {
      table[i].key = to_bytes(arguments[i].first);
      table[i].value.kind = AMQP_FIELD_KIND_UTF8;
      table[i].value.value.bytes = to_bytes(arguments[i].second);
    }
    return table;
  }
  void open() {
    amqp_channel_open(connection_, ++channel_);
    EXPECT_EQ(outcome(), "ok");
  }
  std::string outcome() {
    const auto reply = amqp_get_rpc_reply(connection_);
    if (reply.reply_type == AMQP_RESPONSE_NORMAL) return "ok";
    if (reply.reply_type == AMQP_RESPONSE_SERVER_EXCEPTION && reply.reply.id == AMQP_CHANNEL_CLOSE_METHOD)
      return closed(reply.reply.decoded);
    return "the connection broke";
  }
  std::string closed(const void* decoded) {
    const auto& text = static_cast<const amqp_channel_close_t*>(decoded)->reply_text;
    std::string why(static_cast<const char*>(text.bytes), text.len);
    amqp_channel_close_ok_t ok{};
    amqp_send_method(connection_, channel_, AMQP_CHANNEL_CLOSE_OK_METHOD, &ok);
    return why;
  }
  const Connection held_;
  const amqp_connection_state_t connection_;
  amqp_channel_t channel_ = 0;
};

class RabbitMqUsers : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = testing::TempDir();
    std::ofstream(folder_ + "/rabbitmq_users.json") << definitions();
    std::ofstream(folder_ + "/rabbitmq_password") << password << '\n';
    server_ = new tests::PrivateServer("rabbitmq.py", {"--users", folder_ + "/rabbitmq_users.json"});
  }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }

  static std::unique_ptr<Broker> broker_of(const std::string& user, bool is_gateway) {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.user = user;
    options.password_file = folder_ + "/rabbitmq_password";
    if (is_gateway) {
      options.properties = {
          {"exchange", exchange}, {"reader", user + "-reads"}, {"reader_password_file", options.password_file}};
    }
    return make_broker(options);
  }
  static void expect_to_get_through(const std::string& gateway) {
    const Topic data{exchange, gateway + ".turtle.one.through", false};  // of which no other test has a queue
    const auto sender = broker_of(gateway, true), workers = broker_of("workers", false);
    Inbox inbox;
    const auto reads = workers->subscribe(data, {}, inbox.handler());
    expect_arrivals(*sender->publisher(data, {}), inbox, 1);
  }
  static std::string folder_;
  static tests::PrivateServer* server_;
};
std::string RabbitMqUsers::folder_;
tests::PrivateServer* RabbitMqUsers::server_ = nullptr;

TEST_F(RabbitMqUsers, GatewaysAndWorkersGetEachOthersMessages) {
  const auto gateway = broker_of("gateway-1", true), workers = broker_of("workers", false);
  for (const bool durable : {false, true}) {
    const std::string suffix = durable ? ".kept" : "";
    const Topic data{exchange, "gateway-1.turtle.one.data" + suffix, durable};
    const Topic control{exchange, "gateway-1.turtle.one.control" + suffix, durable};
    Inbox at_workers, at_gateway;
    SubscriptionOptions as_group;
    as_group.group = "echo";
    const auto reads_data = workers->subscribe(data, as_group, at_workers.handler());
    const auto reads_control = gateway->subscribe(control, {}, at_gateway.handler());
    const auto sends_data = gateway->publisher(data, {}), sends_control = workers->publisher(control, {});
    expect_arrivals(*sends_data, at_workers, 1);
    expect_arrivals(*sends_control, at_gateway, 4);
  }
}

TEST_F(RabbitMqUsers, TheThiefOfAGatewayNeitherSendsAsAnotherOneNorReadsItsMessages) {
  const std::string own = "gateway-1.turtle.one.data", foreign = "gateway-2.turtle.two.data";
  const auto refused = HasSubstr("ACCESS_REFUSED");
  Attempts writer(server_->url(), "gateway-1"), reader(server_->url(), "gateway-1-reads");
  EXPECT_EQ(writer.publish(exchange, own), "ok");
  EXPECT_EQ(reader.declare("gateway-1.mine"), "ok");
  EXPECT_EQ(reader.bind("gateway-1.mine", exchange, own), "ok");

  // Straight on.
  EXPECT_THAT(writer.publish(exchange, foreign), refused);
  EXPECT_THAT(writer.publish("", foreign), refused) << "the queue itself, by the server's own exchange";
  for (const auto& key : {foreign, std::string("#"), std::string("*.turtle.#"), std::string("gateway-1")})
    EXPECT_THAT(reader.bind("gateway-1.mine", exchange, key), refused) << key;
  EXPECT_THAT(reader.declare("gateway-2.turtle.two.control"), refused);
  EXPECT_THAT(reader.consume("gateway-2.turtle.two.control"), refused);
  EXPECT_THAT(reader.publish(exchange, own), refused);

  // By what hands a message on without its sender: it takes both users' rights in one.
  const std::vector<std::pair<std::string, std::string>> dead = {{"x-dead-letter-exchange", exchange},
                                                                 {"x-dead-letter-routing-key", foreign}};
  const std::vector<std::pair<std::string, std::string>> alternate = {{"alternate-exchange", exchange}};
  EXPECT_THAT(reader.declare("gateway-1.dead", dead), refused);
  EXPECT_THAT(reader.declare_exchange("gateway-1.alternate", alternate), refused);
  EXPECT_EQ(reader.declare_exchange("gateway-1.source"), "ok");
  EXPECT_THAT(reader.bind_exchange(exchange, "gateway-1.source", "#"), refused);
  EXPECT_THAT(reader.bind_exchange("gateway-1.source", exchange, "#"), refused);
  EXPECT_THAT(writer.declare("gateway-1.dead", dead), refused);
  EXPECT_THAT(writer.declare_exchange("gateway-1.alternate", alternate), refused);
  EXPECT_THAT(writer.bind_exchange(exchange, "gateway-1.source", "#"), refused);
  EXPECT_THAT(writer.publish("gateway-1.source", foreign), refused);
}

TEST_F(RabbitMqUsers, TheThiefOfAGatewayFillsNoQueueBeyondALimitAndOthersGoOn) {
  const std::string own = "gateway-1.turtle.flood", source = "gateway-1.source", megabyte(1 << 20, 'x');
  Attempts writer(server_->url(), "gateway-1"), reader(server_->url(), "gateway-1-reads");
  ASSERT_EQ(reader.declare(own), "ok");
  ASSERT_EQ(reader.bind(own, exchange, own), "ok");
  ASSERT_EQ(reader.declare_exchange(source), "ok");
  ASSERT_EQ(reader.bind(own, source, own), "ok");
  int taken = 0;
  while (taken < 300 && writer.publish(exchange, own, megabyte) == "ok") ++taken;
  EXPECT_THAT(taken, testing::AllOf(testing::Gt(0), testing::Lt(300)));
  EXPECT_EQ(writer.publish(exchange, own, megabyte), "full");
  EXPECT_EQ(reader.publish(source, own, megabyte), "full") << "by an exchange of its own";
  expect_to_get_through("gateway-2");
  expect_to_get_through("gateway-1");
  EXPECT_EQ(reader.remove(own), taken) << "none that was taken is lost";
}

/// SECURITY.md, "Floods": the server counts in no queue's length what it has given to a reader.
TEST_F(RabbitMqUsers, TheThiefOfAGatewayWhoReadsAndAcknowledgesNothingHasMoreThanAQueueMayHold) {
  const std::string own = "gateway-1.turtle.held", megabyte(1 << 20, 'x');
  constexpr int more_than_a_queue_holds = 40;  // megabytes
  Attempts writer(server_->url(), "gateway-1"), reader(server_->url(), "gateway-1-reads");
  ASSERT_EQ(reader.declare(own), "ok");
  ASSERT_EQ(reader.bind(own, exchange, own), "ok");
  ASSERT_EQ(reader.hold(own), "ok");
  for (int sent = 0; sent < more_than_a_queue_holds; ++sent) {
    ASSERT_EQ(writer.publish(exchange, own, megabyte), "ok") << sent;
    ASSERT_TRUE(reader.takes_one()) << sent;
  }
  Attempts remover(server_->url(), "gateway-1-reads");
  EXPECT_EQ(remover.remove(own), 0) << "so many messages does the server say that it has";
}

TEST_F(RabbitMqUsers, TheThiefOfAGatewayTakesNoConnectionsChannelsOrQueuesWithoutEnd) {
  const auto data = Topic{exchange, "gateway-2.turtle.two.early", false};
  Inbox inbox;
  const auto gateway = broker_of("gateway-2", true), workers = broker_of("workers", false);
  const auto reads = workers->subscribe(data, {}, inbox.handler());
  const auto sends = gateway->publisher(data, {});
  expect_arrivals(*sends, inbox, 1);
  for (const char* user : {"gateway-1", "gateway-1-reads"}) {
    std::vector<Connection> held;
    while (held.size() < 300) {
      auto one = log_in(server_->url(), user);
      if (!one) break;
      held.push_back(std::move(one));
    }
    EXPECT_THAT(held.size(), testing::AllOf(testing::Gt(4U), testing::Lt(300U))) << user;
  }
  const auto lets_in = [&] { return log_in(server_->url(), "gateway-1-reads") != nullptr; };
  ASSERT_TRUE(eventually(lets_in, patience)) << "the server counts a connection until it has seen its end";

  {
    Attempts first(server_->url(), "gateway-1-reads"), second(server_->url(), "gateway-1-reads");
    int open = 0;
    while (open < 1500 && first.is_open()) ++open;  // one connection may have 2047
    while (open < 3000 && second.is_open()) ++open;
    EXPECT_THAT(open, testing::AllOf(testing::Gt(100), testing::Lt(3000)));
  }

  ASSERT_TRUE(eventually(lets_in, patience));
  Attempts reader(server_->url(), "gateway-1-reads");
  std::string answer = "ok";
  int queues = 0;
  while (queues < 100 && answer == "ok") answer = reader.declare("gateway-1.many" + std::to_string(++queues), {}, true);
  EXPECT_THAT(answer, HasSubstr("queue limit"));
  Attempts late(server_->url(), "workers");
  EXPECT_THAT(late.declare("gateway-2.turtle.two.late"), HasSubstr("queue limit"))
      << "SECURITY.md says that it takes all";
  publish_numbers(*sends, 4, 6);
  EXPECT_TRUE(inbox.wait_for(6)) << "whoever has its queue goes on";
}

TEST_F(RabbitMqUsers, WhenAGatewaysUsersAreDeletedItsOpenConnectionsEnd) {
  Attempts writer(server_->url(), "gateway-2"), reader(server_->url(), "gateway-2-reads");
  const std::string own = "gateway-2.turtle.two.data";
  EXPECT_EQ(writer.publish(exchange, own), "ok") << "the attack";
  EXPECT_EQ(reader.declare("gateway-2.mine"), "ok");
  for (const std::string user : {"gateway-2", "gateway-2-reads"}) server_->command("forget " + user, "FORGOTTEN");
  EXPECT_TRUE(eventually([&] { return !writer.is_open() && !reader.is_open(); }));
  Attempts other(server_->url(), "gateway-1");
  EXPECT_EQ(other.publish(exchange, "gateway-1.turtle.one.data"), "ok") << "others go on";
}

TEST_F(RabbitMqUsers, WhenTheWorkersHaveAnotherPasswordTheStolenOneAndWhatIsOpenWithItAreWorthNothing) {
  constexpr const char* other = "open";
  Attempts thief(server_->url(), "workers"), gateway(server_->url(), "gateway-1");
  EXPECT_EQ(thief.publish(exchange, "gateway-1.turtle.one.control"), "ok") << "the attack";
  const std::string file = folder_ + "/rabbitmq_renewed.json";
  std::ofstream(file) << definitions(other);
  server_->command("renew " + file, "RENEWED");
  EXPECT_TRUE(eventually([&] { return !thief.is_open(); }));
  EXPECT_EQ(log_in(server_->url(), "workers"), nullptr);
  EXPECT_NE(log_in(server_->url(), "workers", other), nullptr);
  EXPECT_TRUE(gateway.is_open()) << "others go on";
  server_->command("renew " + folder_ + "/rabbitmq_users.json", "RENEWED");
}

TEST_F(RabbitMqUsers, TheThiefOfAWorkerReachesTheGatewaysQueuesAndKeysOnly) {
  const auto refused = HasSubstr("ACCESS_REFUSED");
  Attempts worker(server_->url(), "workers");
  const std::string queue = "gateway-2.turtle.two.data.echo", foreign = "lab.turtle.one.data";
  EXPECT_EQ(worker.publish(exchange, "gateway-2.turtle.two.control"), "ok") << "commands to devices, which it may send";
  EXPECT_EQ(worker.declare(queue), "ok");
  EXPECT_EQ(worker.bind(queue, exchange, "gateway-2.turtle.two.data"), "ok");

  for (const auto& key :
       {foreign, std::string("gateway-10.turtle.one.data"), std::string("#"), std::string("*.turtle.#")}) {
    EXPECT_THAT(worker.bind(queue, exchange, key), refused) << key;
    EXPECT_THAT(worker.publish(exchange, key), refused) << key;
  }
  EXPECT_THAT(worker.declare(foreign), refused);
  EXPECT_THAT(worker.consume(foreign), refused);
  EXPECT_THAT(worker.publish("", queue), refused) << "the queue itself, by the server's own exchange";
  EXPECT_THAT(worker.publish("amq.direct", queue), refused);
  EXPECT_THAT(worker.declare_exchange("lab.source"), refused);
  EXPECT_THAT(worker.bind_exchange(exchange, "amq.fanout", "#"), refused);
}

/// SECURITY.md: whoever has a place in the network, where something is sent without TLS.
TEST_F(RabbitMqUsers, AListenerOnTheWayToThePlainPortHearsPasswordsAndMessages) {
  const tests::TamperingProxy listener(static_cast<std::uint16_t>(parse_broker_url(server_->url()).port));
  Attempts bench("amqp://127.0.0.1:" + std::to_string(listener.port()) + "/", "bench");
  EXPECT_EQ(bench.publish(exchange, "bench.one", "what the benchmark sends"), "ok");
  EXPECT_THAT(listener.heard(), testing::AllOf(HasSubstr(password), HasSubstr("what the benchmark sends")));
}

/// SECURITY.md, "Floods". The last test, because the server's disk stays small.
TEST_F(RabbitMqUsers, TheThiefOfAGatewayFillsTheDiskAndAllWhoSendWaitUntilWhatItHasIsGone) {
  const std::string body(4 << 20, 'x');
  constexpr int megabytes = 150, most = 400;  // messages, if nobody stops it
  const auto data = Topic{exchange, "gateway-2.turtle.two.spared", false};
  Inbox inbox;
  const auto gateway = broker_of("gateway-2", true), workers = broker_of("workers", false);
  const auto reads = workers->subscribe(data, {}, inbox.handler());
  const auto sends = gateway->publisher(data, {});
  expect_arrivals(*sends, inbox, 1);
  server_->command("disk " + std::to_string(megabytes), "DISK");
  const auto others_wait_until = [&](const auto& relief, int number) {
    sends->publish(text_message(std::to_string(number)));
    EXPECT_FALSE(sends->drain(moment)) << "the attack";
    relief();
    EXPECT_TRUE(inbox.wait_for(static_cast<std::size_t>(number)));
  };

  // By many queues, none of which holds more than it may.
  std::vector<std::string> queues;
  {
    Attempts writer(server_->url(), "gateway-1"), reader(server_->url(), "gateway-1-reads");
    std::string answer = "full";
    for (int sent = 0; sent < most && answer != "blocked"; ++sent) {
      if (answer == "full") {
        queues.push_back("gateway-1.filled" + std::to_string(sent));
        ASSERT_EQ(reader.declare_durable(queues.back()), "ok");
        ASSERT_EQ(reader.bind(queues.back(), exchange, queues.back()), "ok");
      }
      answer = writer.publish(exchange, queues.back(), body, true);
    }
    ASSERT_EQ(answer, "blocked");
    EXPECT_GT(queues.size(), 1U);
  }
  others_wait_until(
      [&] {
        Attempts remover(server_->url(), "gateway-1-reads");
        for (const auto& queue : queues) EXPECT_GE(remover.remove(queue), 0);
      },
      4);

  // By one queue, whose reader acknowledges nothing.
  const std::string held = "gateway-1.turtle.hoarded";
  auto reader = std::make_unique<Attempts>(server_->url(), "gateway-1-reads");
  {
    Attempts writer(server_->url(), "gateway-1");
    ASSERT_EQ(reader->declare_durable(held), "ok");
    ASSERT_EQ(reader->bind(held, exchange, held), "ok");
    ASSERT_EQ(reader->hold(held), "ok");
    int sent = 0;
    std::string answer;
    while (sent < most && (answer = writer.publish(exchange, held, body, true)) == "ok") {
      ASSERT_TRUE(reader->takes_one()) << sent;
      ++sent;
    }
    ASSERT_EQ(answer, "blocked");
  }
  others_wait_until(
      [&] {
        reader.reset();
        EXPECT_GE(Attempts(server_->url(), "gateway-1-reads").remove(held), 0);
      },
      5);
}

}  // namespace
}  // namespace iotcloud::brokers
