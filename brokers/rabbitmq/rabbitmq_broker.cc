#include "iotcloud/brokers/rabbitmq/rabbitmq_broker.h"

#include <utility>

#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/connections.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

/// AMQP's short strings: names of exchanges and queues, routing keys.
constexpr std::size_t longest_name = 255;

void check_name(const std::string& name, const char* what) {
  if (!name.empty() && name.size() <= longest_name) return;
  throw config::Error(std::string("the ") + what + " \"" + name + "\" must have 1 to 255 bytes for RabbitMQ");
}

class RabbitMqPublisher final : public Publisher {
 public:
  RabbitMqPublisher(PublishLink& link, const Topic& topic, const PublisherOptions& options)
      : link_(link), outbox_(link.add(topic, options)) {}
  ~RabbitMqPublisher() override { link_.remove(outbox_); }
  PublishStatus publish(Message message) override { return link_.publish(outbox_, std::move(message)); }
  PublishStatus publish_again(Message message, const Past& past) override {
    return link_.publish(outbox_, std::move(message), past);
  }
  bool drain(std::chrono::milliseconds limit) override { return link_.drain(outbox_, limit); }
  std::size_t pending() const override { return link_.pending(*outbox_); }

 private:
  PublishLink& link_;
  const std::shared_ptr<Outbox> outbox_;
};

class RabbitMqSubscription final : public Subscription {
 public:
  explicit RabbitMqSubscription(std::shared_ptr<Inlet> inlet) : inlet_(std::move(inlet)) {}
  // It may move to another connection between the question where it is and what is asked of it there.
  ~RabbitMqSubscription() override {
    while (!inlet_->home()->remove(inlet_)) {
    }
  }
  void pause() override {
    while (!inlet_->home()->pause(*inlet_)) {
    }
  }
  void resume() override {
    while (!inlet_->home()->resume(inlet_)) {
    }
  }
  bool active() const override { return inlet_->home()->active(*inlet_); }

 private:
  const std::shared_ptr<Inlet> inlet_;
};

class RabbitMqBroker final : public Broker {
 public:
  RabbitMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : url_(options.urls.front()),
        cluster_(options, urls),
        meters_(options.metrics, "rabbitmq"),
        connections_(cluster_, meters_, options.clock != nullptr ? *options.clock : config::system_clock()) {}
  ~RabbitMqBroker() override { connections_.stop_reading(); }  // its dead letters die next

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check_name(topic.name, "topic");
    return std::make_unique<RabbitMqPublisher>(connections_.publishing(options.priority), topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check_name(topic.name, "topic");
    check_name(options.group.empty() ? topic.name : topic.name + "." + options.group, "queue");
    return std::make_unique<RabbitMqSubscription>(
        connections_.subscribe(topic, options, dead_letters_.guard(topic, options, std::move(handler))));
  }

  ConnectionState state() const override { return connections_.state(); }
  const std::string& url() const override { return url_; }

 private:
  const std::string url_;
  const Cluster cluster_;
  Meters meters_;
  Connections connections_;
  DeadLetters dead_letters_{*this};  ///< its publishers die before the connections
};

}  // namespace

std::unique_ptr<Broker> make_rabbitmq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  return std::make_unique<RabbitMqBroker>(options, urls);
}

}  // namespace iotcloud::brokers::rabbitmq
