#include <atomic>
#include <span>
#include <stdexcept>
#include <thread>

#include <iotcloud/bench/brokers/client.h>
#include <iotcloud/bench/harness/bodies.h>
#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/memory.h>

namespace iotcloud::bench {

namespace {

constexpr std::int64_t connect_limit_ns = 60'000'000'000;

/// This project's client, through the public interface of the brokers only.
class IotcloudClient final : public Client {
 public:
  IotcloudClient(const BrokerOptions& options, Load& load)
      : options_(options), load_(load), device_(make_broker()), cloud_(make_broker()) {
    for (unsigned driver = 0; driver < options.drivers; ++driver) bodies_.emplace_back(options.size);
  }

  void connect() override {
    const unsigned topics = options_.shared ? 1 : options_.drivers;
    for (unsigned index = 0; index < topics; ++index) {
      const brokers::Topic up = topic(index, "data"), down = topic(index, "control");
      replies_.push_back(device_->subscribe(down, reading(""), [this](brokers::Delivery delivery) {
        const std::optional<unsigned> next = load_.arrived(delivery.message.payload.bytes());
        delivery.settle(brokers::Settlement::accept);
        if (next) send(*next);
      }));
      echoes_.push_back(cloud_->publisher(down, sending()));
      requests_.push_back(
          cloud_->subscribe(up, reading("bench"), [this, back = echoes_.back().get()](brokers::Delivery delivery) {
            publish(*back, delivery.message);
            delivery.settle(brokers::Settlement::accept);
          }));
      senders_.push_back(device_->publisher(up, sending()));
    }
    const std::int64_t limit = now_ns() + connect_limit_ns;
    for (const auto* subscriptions : {&replies_, &requests_}) {
      for (const auto& subscription : *subscriptions) {
        while (!subscription->active()) {
          if (now_ns() > limit) throw std::runtime_error("not all subscriptions were active within 60 s");
          sleep_until(now_ns() + 1'000'000);
        }
      }
    }
  }

  void begin() override {
    schedule_ = std::jthread([this] { load_.send_on_schedule([this](unsigned driver) { send(driver); }); });
  }

  void stop() override {
    schedule_ = {};
    replies_.clear();
    requests_.clear();
    for (const auto* publishers : {&senders_, &echoes_}) {
      for (const auto& publisher : *publishers) {
        if (!publisher->drain(std::chrono::seconds(20))) throw std::runtime_error("some messages were not confirmed");
      }
    }
    senders_.clear();
    echoes_.clear();
  }

 private:
  std::unique_ptr<brokers::Broker> make_broker() const {
    brokers::BrokerOptions options;
    options.urls = {options_.url};
    return brokers::make_broker(options);
  }

  brokers::Topic topic(unsigned index, const std::string& channel) const {
    brokers::Topic topic;
    topic.exchange = options_.name;
    topic.name = options_.name + (options_.shared ? "." : "." + std::to_string(index) + ".") + channel;
    return topic;
  }

  brokers::PublisherOptions sending() {
    brokers::PublisherOptions sending;
    sending.capacity = 4096;
    sending.on_writable = [this] {
      ++writable_;
      writable_.notify_all();
    };
    return sending;
  }

  brokers::SubscriptionOptions reading(const std::string& group) const {
    brokers::SubscriptionOptions reading;
    reading.group = group;
    reading.prefetch = 200;
    reading.automatic_ack = !options_.acknowledgements;
    return reading;
  }

  void send(unsigned driver) {
    load_.send(driver, [&](const Stamp& stamp) {
      brokers::Message message;
      message.payload = bodies_[driver].beginning_with(std::as_bytes(std::span(&stamp, 1)));
      message.driver_id = std::to_string(driver);
      message.gateway_id = "bench";
      message.time_ms = 1;
      publish(*senders_[options_.shared ? 0 : driver], message);
    });
  }

  /// Waits while the publisher is full, under a load above what the broker takes.
  void publish(brokers::Publisher& publisher, const brokers::Message& message) {
    for (;;) {
      const std::uint64_t seen = writable_;
      if (publisher.publish(message) != brokers::PublishStatus::would_block) return;
      writable_.wait(seen);
    }
  }

  const BrokerOptions& options_;
  Load& load_;
  const std::unique_ptr<brokers::Broker> device_, cloud_;
  std::vector<Bodies> bodies_;
  std::atomic<std::uint64_t> writable_ = 0;  ///< calls of on_writable
  std::vector<std::unique_ptr<brokers::Publisher>> senders_, echoes_;
  std::vector<std::unique_ptr<brokers::Subscription>> replies_, requests_;
  std::jthread schedule_;
};

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  using namespace iotcloud::bench;
  iotcloud::config::keep_freed_memory();  // as the project's daemons do
  return measure_client("iotcloud", argc, argv, [](const BrokerOptions& options, Load& load) {
    return std::make_unique<IotcloudClient>(options, load);
  });
}
