#include <limits>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/channel_reader.h>
#include <iotcloud/topology/endpoints/dead_letters.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

}  // namespace

/// The letters of one broker.
class DeadLetters::Sender {
 public:
  Sender(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic, config::Counter& sent,
         config::Counter& refused)
      : topic_(topic.name), sent_(sent), refused_(refused), broker_(std::move(broker)) {
    brokers::PublisherOptions options;
    options.own_queue = true;
    options.capacity = std::numeric_limits<int>::max();  // each holds an unsettled message, and prefetch limits those
    options.on_outcome = [this](std::uint64_t number, brokers::Outcome outcome, const std::string& reason) {
      on_outcome(number, outcome, reason);
    };
    publisher_ = broker_->publisher(topic, options);
  }

  void send(brokers::Message letter, Arrival arrival) {
    const std::lock_guard lock(mutex_);  // the outcome waits until its number is known
    if (publisher_->publish(std::move(letter)) != brokers::PublishStatus::accepted) return;  // it stays in the broker
    under_way_.emplace(++last_number_, std::move(arrival));
  }

  void drain(std::chrono::milliseconds limit) { static_cast<void>(publisher_->drain(limit)); }

 private:
  void on_outcome(std::uint64_t number, brokers::Outcome outcome, const std::string& reason) {
    std::unique_lock lock(mutex_);
    auto node = under_way_.extract(number);
    lock.unlock();
    if (node.empty()) return;
    auto& delivery = node.mapped().delivery;
    if (outcome == brokers::Outcome::confirmed) {
      sent_.add();
      delivery.settle(brokers::Settlement::accept);
    } else if (outcome == brokers::Outcome::refused) {
      refused_.add();
      logger.error("the broker refused a dead letter for {}: {}; the message is rejected", topic_, reason);
      delivery.settle(brokers::Settlement::reject);
    }
    // Otherwise nobody knows, and the message goes back to its queue.
  }

  const std::string topic_;
  config::Counter& sent_;
  config::Counter& refused_;
  std::mutex mutex_;
  std::uint64_t last_number_ = 0;               ///< guarded by mutex_
  std::map<std::uint64_t, Arrival> under_way_;  ///< by publish number; guarded by mutex_
  const std::shared_ptr<brokers::Broker> broker_;
  std::unique_ptr<brokers::Publisher> publisher_;  ///< dies first: no callback runs after it
};

DeadLetters::DeadLetters(EndpointServicesPtr services, std::string component, std::string topic)
    : services_(std::move(services)), component_(std::move(component)), topic_{"", std::move(topic), true} {}

DeadLetters::~DeadLetters() = default;

void DeadLetters::send(Arrival arrival) {
  brokers::Message letter = arrival.delivery.message;
  letter.properties.set("dead-letter-reason", "the tuple failed or timed out");
  letter.properties.set("dead-letter-tries", std::to_string(arrival.tries));
  letter.properties.set("dead-letter-topic", arrival.reader->topic().name);
  letter.properties.set("dead-letter-topology", services_->topology);
  letter.properties.set("dead-letter-component", component_);
  if (letter.driver_id.empty()) letter.driver_id = arrival.reader->driver_id();
  std::shared_ptr<Sender> sender;
  {
    const std::lock_guard lock(mutex_);
    auto& known = senders_[arrival.reader->broker_url()];
    if (!known) {
      const config::Labels labels{{"topology", services_->topology}, {"component", component_}};
      known = std::make_shared<Sender>(
          services_->brokers->get(arrival.reader->broker_url()), topic_,
          services_->metrics->counter("iotcloud_spout_dead_letters_total",
                                      "Messages given up and moved to the dead-letter topic", labels),
          services_->metrics->counter("iotcloud_spout_rejected_total", rejected_help, labels));
    }
    sender = known;
  }
  sender->send(std::move(letter), std::move(arrival));
}

void DeadLetters::drain(std::chrono::milliseconds limit) {
  std::map<std::string, std::shared_ptr<Sender>> senders;
  {
    const std::lock_guard lock(mutex_);
    senders = senders_;
  }
  for (const auto& [url, sender] : senders) sender->drain(limit);
}

}  // namespace iotcloud::topology
