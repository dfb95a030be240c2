#include "iotcloud/brokers/rabbitmq/rabbitmq_broker.h"

#include <optional>
#include <utility>

#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/connections.h"
#include "iotcloud/brokers/rabbitmq/queue_remover.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

/// Limit of AMQP's short strings: names of exchanges and queues, routing keys.
constexpr std::size_t longest_name = 255;

void check_name(const std::string& name, const char* what) {
  if (!name.empty() && name.size() <= longest_name) return;
  throw config::Error(std::string("the ") + what + " \"" + name + "\" must have 1 to 255 bytes for RabbitMQ");
}

class RabbitMqSubscription final : public Subscription {
 public:
  explicit RabbitMqSubscription(std::shared_ptr<QueueReader> reader) : reader_(std::move(reader)) {}
  // The reader may move to another connection between connection() and the call on that connection, which then returns
  // false: try again.
  ~RabbitMqSubscription() override {
    while (!reader_->connection()->remove(reader_)) {
    }
  }
  void pause() override {
    while (!reader_->connection()->pause(*reader_)) {
    }
  }
  void resume() override {
    while (!reader_->connection()->resume(*reader_)) {
    }
  }
  bool raise_prefetch(std::uint16_t prefetch) override {
    if (prefetch > reader_->options.prefetch_limit) return false;
    std::optional<bool> raised;
    while (!raised) raised = reader_->connection()->raise_prefetch(reader_, prefetch);
    return *raised;
  }
  std::optional<std::uint64_t> backlog() override {
    std::optional<std::uint64_t> last;
    while (!reader_->connection()->backlog(reader_, last)) {
    }
    return last;
  }
  bool active() const override { return reader_->connection()->active(*reader_); }

 private:
  const std::shared_ptr<QueueReader> reader_;
};

class RabbitMqBroker final : public Broker {
 public:
  RabbitMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : url_(options.urls.front()),
        cluster_(options, urls),
        meters_(options.metrics, "rabbitmq"),
        clock_(options.clock != nullptr ? *options.clock : config::system_clock()) {}
  ~RabbitMqBroker() override { connections_.stop_reading(); }  // the member dead_letters_ is destroyed next

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check_name(topic.name, "topic");
    return std::make_unique<client::CorePublisher>(connections_.publishing(options.priority).core(), topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check_name(topic.name, "topic");
    check_name(options.group.empty() ? topic.name : topic.name + "." + options.group, "queue");
    return std::make_unique<RabbitMqSubscription>(
        connections_.subscribe(topic, options, dead_letters_.guard(topic, options, std::move(handler))));
  }

  // Of quorum queues the server cannot be asked to remove only those that are empty and unused. Queues that are not
  // durable end by themselves.
  void remove_queue(const Topic& topic, const std::string& group) override {
    if (!topic.durable || cluster_.queue_type() == QueueType::quorum) return;
    queue_remover_.remove(group.empty() ? topic.name : topic.name + "." + group);
  }

  ConnectionState state() const override { return connections_.state(); }
  std::string problem() const override { return connections_.problem(); }
  const std::string& url() const override { return url_; }

 private:
  const std::string url_;
  const Cluster cluster_;
  Meters meters_;
  const config::Clock& clock_;
  QueueRemover queue_remover_{attempt_at(cluster_), clock_};
  Connections connections_{cluster_, meters_, clock_};
  /// Declared after the connections, so that its publishers are destroyed before them.
  DeadLetters dead_letters_{*this};
};

}  // namespace

std::unique_ptr<Broker> make_rabbitmq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  return std::make_unique<RabbitMqBroker>(options, urls);
}

}  // namespace iotcloud::brokers::rabbitmq
