#include <array>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include <librdkafka/rdkafka.h>

#include <iotcloud/bench/brokers/client.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

namespace {

using Settings = std::initializer_list<std::pair<const char*, std::string>>;

constexpr int poll_limit_ms = 100;
constexpr std::int64_t connect_limit_ns = 60'000'000'000;

struct Destroy {
  void operator()(rd_kafka_t* client) const { rd_kafka_destroy(client); }
  void operator()(rd_kafka_topic_t* topic) const { rd_kafka_topic_destroy(topic); }
  void operator()(rd_kafka_message_t* message) const { rd_kafka_message_destroy(message); }
};

/// Checks a delivery report: one failed delivery makes the round worthless.
void on_report(rd_kafka_t*, const rd_kafka_message_t* message, void*) {
  if (message->err != RD_KAFKA_RESP_ERR_NO_ERROR)
    std::fprintf(stderr, "not sent: %s\n", rd_kafka_err2str(message->err));
}

std::unique_ptr<rd_kafka_t, Destroy> make(rd_kafka_type_t type, const BrokerOptions& options, Settings settings) {
  constexpr std::string_view scheme = "kafka://";
  if (!options.url.starts_with(scheme)) throw std::runtime_error("not a URL of Kafka: " + options.url);
  std::array<char, 512> problem{};
  rd_kafka_conf_t* configuration = rd_kafka_conf_new();
  const auto set = [&](const char* name, const std::string& value) {
    if (rd_kafka_conf_set(configuration, name, value.c_str(), problem.data(), problem.size()) != RD_KAFKA_CONF_OK) {
      throw std::runtime_error(problem.data());
    }
  };
  std::string server = options.url.substr(scheme.size());
  if (const auto at = server.find('@'); at != std::string::npos) {
    const auto colon = server.find(':');
    if (colon >= at) throw std::runtime_error("a user without a password: " + options.url);
    set("security.protocol", "sasl_plaintext");
    set("sasl.mechanisms", "PLAIN");
    set("sasl.username", server.substr(0, colon));
    set("sasl.password", server.substr(colon + 1, at - colon - 1));
    server.erase(0, at + 1);
  }
  set("bootstrap.servers", server);
  set("message.max.bytes", "16777216");
  for (const auto& [name, value] : settings) set(name, value);
  if (type == RD_KAFKA_PRODUCER && options.confirms) rd_kafka_conf_set_dr_msg_cb(configuration, on_report);
  rd_kafka_t* client = rd_kafka_new(type, configuration, problem.data(), problem.size());
  if (client == nullptr) throw std::runtime_error(problem.data());
  return std::unique_ptr<rd_kafka_t, Destroy>(client);
}

/// One end of the bare client, on librdkafka alone: a producer with a thread that takes its delivery reports, and a
/// group's consumer with a polling thread. It gives the same guarantees as this project's client. With confirms every
/// message has an outcome, and none is stored twice or overtaken; without them a producer has a request for each
/// message under way as soon as the server is slow, which makes the server slower still. With acknowledgements the
/// group's place is stored as often as this project's client does it.
class End {
 public:
  End(const BrokerOptions& options, std::string from, const std::string& to)
      : from_(std::move(from)),
        producer_(make(RD_KAFKA_PRODUCER, options,
                       {{"linger.ms", "0"},
                        {"acks", options.confirms ? "all" : "0"},
                        {"enable.idempotence", options.confirms ? "true" : "false"}})),
        consumer_(make(RD_KAFKA_CONSUMER, options,
                       {{"group.id", from_},
                        {"enable.auto.commit", options.acknowledgements ? "true" : "false"},
                        {"auto.commit.interval.ms", "100"},
                        {"auto.offset.reset", "earliest"},  // messages of an earlier run are recognised by their stamps
                        {"fetch.min.bytes", "1"},
                        {"allow.auto.create.topics", "true"},
                        {"topic.metadata.refresh.interval.ms", "1000"},
                        {"fetch.error.backoff.ms", "10"}})),
        topic_(rd_kafka_topic_new(producer_.get(), to.c_str(), nullptr)) {
    rd_kafka_poll_set_consumer(consumer_.get());
    rd_kafka_topic_partition_list_t* topics = rd_kafka_topic_partition_list_new(1);
    rd_kafka_topic_partition_list_add(topics, from_.c_str(), RD_KAFKA_PARTITION_UA);
    const rd_kafka_resp_err_t failure = rd_kafka_subscribe(consumer_.get(), topics);
    rd_kafka_topic_partition_list_destroy(topics);
    if (failure != RD_KAFKA_RESP_ERR_NO_ERROR) throw std::runtime_error(rd_kafka_err2str(failure));
    if (!options.confirms) return;
    reports_ = std::jthread([producer = producer_.get()](const std::stop_token& stop) {
      while (!stop.stop_requested()) rd_kafka_poll(producer, poll_limit_ms);
    });
  }

  void wait_until_assigned() {
    for (const std::int64_t limit = now_ns() + connect_limit_ns;;) {
      rd_kafka_topic_partition_list_t* partitions = nullptr;
      rd_kafka_assignment(consumer_.get(), &partitions);
      const int count = partitions->cnt;
      rd_kafka_topic_partition_list_destroy(partitions);
      if (count > 0) return;
      if (now_ns() > limit) throw std::runtime_error(from_ + " was not assigned within 60 s");
      rd_kafka_message_t* early = rd_kafka_consumer_poll(consumer_.get(), poll_limit_ms);
      if (early != nullptr) rd_kafka_message_destroy(early);
    }
  }

  /// Copies key and body, as this project's client must for a message that outlives the call.
  void publish(std::string_view key, std::span<const std::byte> body) {
    if (rd_kafka_produce(topic_.get(), RD_KAFKA_PARTITION_UA, RD_KAFKA_MSG_F_COPY, const_cast<std::byte*>(body.data()),
                         body.size(), key.data(), key.size(), nullptr) != 0) {
      throw std::runtime_error(rd_kafka_err2str(rd_kafka_last_error()));
    }
  }

  /// Calls `take(key, body)` for each message until stopped.
  template <typename Take>
  void read(const std::stop_token& stop, Take&& take) {
    while (!stop.stop_requested()) {
      const std::unique_ptr<rd_kafka_message_t, Destroy> message(
          rd_kafka_consumer_poll(consumer_.get(), poll_limit_ms));
      if (message && message->err == RD_KAFKA_RESP_ERR_NO_ERROR) {
        take(std::string_view(static_cast<const char*>(message->key), message->key_len),
             std::span(static_cast<const std::byte*>(message->payload), message->len));
      }
    }
  }

  void close() {
    reports_ = {};
    rd_kafka_flush(producer_.get(), 10'000);
    rd_kafka_consumer_close(consumer_.get());
  }

 private:
  const std::string from_;
  std::unique_ptr<rd_kafka_t, Destroy> producer_, consumer_;
  std::unique_ptr<rd_kafka_topic_t, Destroy> topic_;  ///< the producer's target
  std::jthread reports_;
};

class KafkaClient final : public Client {
 public:
  KafkaClient(const BrokerOptions& options, Load& load)
      : load_(load),
        device_(options, options.name + ".control", options.name + ".data"),
        cloud_(options, options.name + ".data", options.name + ".control"),
        body_(options.size) {
    for (unsigned driver = 0; driver < options.drivers; ++driver) keys_.push_back(std::to_string(driver));
  }

  void connect() override {
    device_.wait_until_assigned();
    cloud_.wait_until_assigned();
    echo_ = std::jthread([this](const std::stop_token& stop) {
      cloud_.read(stop, [&](std::string_view key, std::span<const std::byte> body) { cloud_.publish(key, body); });
    });
    reader_ = std::jthread([this](const std::stop_token& stop) {
      device_.read(stop, [&](std::string_view, std::span<const std::byte> body) {
        if (const auto next = load_.arrived(body)) send(*next);
      });
    });
  }

  void begin() override {
    schedule_ = std::jthread([this] { load_.send_on_schedule([this](unsigned driver) { send(driver); }); });
  }

  void stop() override {
    schedule_ = {};
    reader_ = {};
    echo_ = {};
    device_.close();
    cloud_.close();
  }

 private:
  void send(unsigned driver) {
    load_.send(driver, [&](const Stamp& stamp) {
      const std::lock_guard lock(body_in_use_);
      std::memcpy(body_.data(), &stamp, sizeof stamp);
      device_.publish(keys_[driver], body_);
    });
  }

  Load& load_;
  End device_, cloud_;
  std::vector<std::string> keys_;
  std::mutex body_in_use_;
  std::vector<std::byte> body_;
  std::jthread echo_, reader_, schedule_;
};

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  using namespace iotcloud::bench;
  return measure_client("kafka", argc, argv, [](const BrokerOptions& options, Load& load) {
    return std::make_unique<KafkaClient>(options, load);
  });
}
