#include <iotcloud/brokers/letter_box.h>
#include <iotcloud/topology/endpoints/receiving/dead_letter_sender.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

/// Sends the dead letters of one broker.
struct DeadLetterSender::Sender {
  Sender(std::shared_ptr<brokers::Broker> of, const std::string& topic, std::function<void(bool)> moved)
      : broker(std::move(of)), box(*broker, topic, std::move(moved)) {}
  const std::shared_ptr<brokers::Broker> broker;
  brokers::LetterBox box;  ///< destroyed before the broker, which it uses
};

DeadLetterSender::DeadLetterSender(EndpointServicesPtr services, std::string component, std::string topic)
    : services_(std::move(services)), component_(std::move(component)), topic_(std::move(topic)) {}

DeadLetterSender::~DeadLetterSender() = default;

void DeadLetterSender::send(ChannelMessage arrival, const std::string& reason) {
  brokers::Message letter = arrival.delivery.message;
  letter.properties.set("dead-letter-reason", reason);
  letter.properties.set("dead-letter-tries", std::to_string(arrival.tries));
  letter.properties.set("dead-letter-topic", arrival.reader->topic().name);
  letter.properties.set("dead-letter-topology", services_->topology.str());
  letter.properties.set("dead-letter-component", component_);
  std::shared_ptr<Sender> sender;
  {
    const config::MutexLock lock(mutex_);
    auto& known = senders_[arrival.reader->address()];
    if (!known) {
      const config::Labels labels{{"topology", services_->topology}, {"component", component_}};
      auto& sent = services_->metrics->counter("iotcloud_spout_dead_letters_total",
                                               "Messages given up and moved to the dead-letter topic", labels);
      auto& refused = services_->metrics->counter("iotcloud_spout_rejected_total", rejected_help, labels);
      known = std::make_shared<Sender>(broker_at(arrival.reader->address(), *services_), topic_,
                                       [&](bool confirmed) { (confirmed ? sent : refused).add(); });
    }
    sender = known;
  }
  sender->box.send(std::move(letter), std::move(arrival.delivery),
                   std::make_shared<HeldReader>(std::move(arrival.reader)));
}

void DeadLetterSender::drain(std::chrono::milliseconds limit) {
  std::map<brokers::BrokerAddress, std::shared_ptr<Sender>> senders;
  {
    const config::MutexLock lock(mutex_);
    senders = senders_;
  }
  for (const auto& [address, sender] : senders) sender->box.drain(limit);
}

}  // namespace iotcloud::topology
