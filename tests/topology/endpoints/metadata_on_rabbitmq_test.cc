// A spout's field `redelivered` on a real RabbitMQ: a message that went to a consumer which died comes marked.
#include <chrono>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <amqp.h>
#include <amqp_tcp_socket.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <iotcloud/tests/topology/endpoints/private_rabbitmq.h>

namespace iotcloud::topology {
namespace {

using testing::ElementsAre;
using testing::Pair;

/// A consumer on librabbitmq alone. It takes one message, settles nothing, and dies with this object: its connection
/// ends without a word, as that of a process that is killed.
class DyingConsumer {
 public:
  DyingConsumer(const std::string& url, const std::string& queue) : connection_(amqp_new_connection()) {
    amqp_socket_t* const socket = amqp_tcp_socket_new(connection_);
    const std::string address = url.substr(url.find('@') + 1);  // amqp://guest:guest@127.0.0.1:PORT/
    const int port = std::stoi(address.substr(address.find(':') + 1));
    require(amqp_socket_open(socket, "127.0.0.1", port) == AMQP_STATUS_OK, "connect");
    const auto login = amqp_login(connection_, "/", 0, 131072, 0, AMQP_SASL_METHOD_PLAIN, "guest", "guest");
    require(login.reply_type == AMQP_RESPONSE_NORMAL, "log in");
    amqp_channel_open(connection_, 1);
    amqp_basic_qos(connection_, 1, 0, 1, 0);
    amqp_basic_consume(connection_, 1, amqp_cstring_bytes(queue.c_str()), amqp_empty_bytes, 0, 0, 0, amqp_empty_table);
    require(amqp_get_rpc_reply(connection_).reply_type == AMQP_RESPONSE_NORMAL, "consume");
    timeval limit{20, 0};
    amqp_envelope_t envelope;
    require(amqp_consume_message(connection_, &envelope, &limit, 0).reply_type == AMQP_RESPONSE_NORMAL,
            "get a message");
    text_.assign(static_cast<const char*>(envelope.message.body.bytes), envelope.message.body.len);
    redelivered_ = envelope.redelivered != 0;
    amqp_destroy_envelope(&envelope);
  }
  ~DyingConsumer() {
    ::shutdown(amqp_get_sockfd(connection_), SHUT_RDWR);
    amqp_destroy_connection(connection_);
  }
  DyingConsumer(const DyingConsumer&) = delete;
  DyingConsumer& operator=(const DyingConsumer&) = delete;
  const std::string& text() const { return text_; }
  bool redelivered() const { return redelivered_; }

 private:
  static void require(bool done, const std::string& what) {
    if (!done) throw std::runtime_error("the consumer cannot " + what);
  }
  amqp_connection_state_t connection_;
  std::string text_;
  bool redelivered_ = false;
};

/// Remembers what it got, and whether it was redelivered.
class RedeliveredBolt final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer&) const override {}
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    const std::lock_guard lock(mutex_);
    got_.emplace_back(tuple.get<std::string>("text"), tuple.get<bool>("redelivered"));
  }
  static std::vector<std::pair<std::string, bool>> got() {
    const std::lock_guard lock(mutex_);
    return got_;
  }

 private:
  static inline std::mutex mutex_;
  static inline std::vector<std::pair<std::string, bool>> got_;  ///< guarded by mutex_
};

class MessageFieldsOnRabbitMq : public EndpointsOnRabbitMq {
 protected:
  void run_worker() {
    ComponentRegistry components;
    components.add_bolt<RedeliveredBolt>("Redelivered");
    run_yaml(
        "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, builder: text, "
        "fields: [text, driverID, redelivered]}\nbolts:\n  see: {class: Redelivered, inputs: {from: in}}\n",
        std::move(components));
  }
};

TEST_F(MessageFieldsOnRabbitMq, SayThatTheServerDeliversAgainWhatAConsumerHadThatDied) {
  show_driver_with_durable_channel("two");
  run_worker();
  const auto publisher = durable_device("two");
  publisher->publish(message("first", "two"));
  ASSERT_TRUE(eventually([] { return RedeliveredBolt::got().size() == 1; }));
  workers_.clear();  // its queue stays
  for (const char* text : {"had by the dead", "had by nobody"}) publisher->publish(message(text, "two"));
  ASSERT_TRUE(publisher->drain(std::chrono::seconds(20)));
  {
    const DyingConsumer consumer(broker_url_, topic("two", "up") + ".t");
    EXPECT_EQ(consumer.text(), "had by the dead");
    EXPECT_FALSE(consumer.redelivered());
  }
  run_worker();
  ASSERT_TRUE(eventually([] { return RedeliveredBolt::got().size() >= 3; }));
  EXPECT_THAT(RedeliveredBolt::got(),
              ElementsAre(Pair("first", false), Pair("had by the dead", true), Pair("had by nobody", false)));
}

}  // namespace
}  // namespace iotcloud::topology
