#include "iotcloud/brokers/kafka/kafka_broker.h"

#include <algorithm>
#include <cctype>
#include <functional>
#include <utility>

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/producer.h"
#include "iotcloud/brokers/kafka/reading/consumer_groups.h"
#include "iotcloud/brokers/kafka/reading/partition_counts.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::kafka {
namespace {

constexpr std::size_t longest_name = 249;
constexpr std::string_view dead_letters_suffix = ".dlq";

void check_topic(const std::string& name) {
  const bool legal = std::all_of(name.begin(), name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '.' || c == '_' || c == '-';
  });
  if (!name.empty() && name.size() <= longest_name && legal && name != "." && name != "..") return;
  throw config::Error("the topic \"" + name +
                      "\" must have 1 to 249 of the letters, digits, dots, underscores and hyphens that Kafka allows; "
                      "give the gateway, the driver and the channel such names");
}

class KafkaSubscription final : public Subscription {
 public:
  /// \param leave called before the subscription ends
  KafkaSubscription(ConsumerGroups& link, const Topic& topic, const SubscriptionOptions& options, Handler handler,
                    std::function<void()> leave)
      : link_(link), subscriber_(link.add(topic, options, std::move(handler))), leave_(std::move(leave)) {}
  ~KafkaSubscription() override {
    leave_();
    link_.remove(subscriber_);
  }
  void pause() override { link_.reader().pause(*subscriber_); }
  void resume() override { link_.reader().resume(*subscriber_); }
  bool raise_prefetch(std::uint16_t prefetch) override { return link_.reader().raise_prefetch(*subscriber_, prefetch); }
  bool active() const override { return link_.reader().active(*subscriber_); }
  std::optional<std::uint64_t> backlog() override { return link_.reader().backlog(*subscriber_); }

 private:
  ConsumerGroups& link_;
  const std::shared_ptr<TopicSubscriber> subscriber_;
  const std::function<void()> leave_;
};

class KafkaPartitionWatch final : public PartitionWatch {
 public:
  KafkaPartitionWatch(PartitionCounts& counts, const std::string& topic, std::function<void(int)> told)
      : counts_(counts), number_(counts.follow(topic, std::move(told))) {}
  ~KafkaPartitionWatch() override { counts_.ignore(number_); }

 private:
  PartitionCounts& counts_;
  const int number_;
};

class KafkaBroker final : public Broker {
 public:
  KafkaBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : url_(options.urls.front()),
        options_(kafka_options(options, urls)),
        meters_(options.metrics, "kafka"),
        clock_(options.clock != nullptr ? *options.clock : config::system_clock()),
        log_(printable_url(options.urls.front())),
        normal_(*this),
        partition_counts_(options_, clock_) {}
  ~KafkaBroker() override = default;

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check_topic(topic.name);
    return std::make_unique<client::CorePublisher>(clients_for(options.priority).publishing.core(), topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check_topic(topic.name);
    SubscriptionOptions all = options;
    // Kafka has no dead letter queue of its own for rejected messages.
    if (all.dead_letter.empty() && !topic.name.ends_with(dead_letters_suffix)) {
      all.dead_letter = topic.name.substr(0, longest_name - dead_letters_suffix.size());
      all.dead_letter += dead_letters_suffix;
    }
    if (!all.automatic_ack) handler = dead_letters_.guard(topic, all, std::move(handler));
    return std::make_unique<KafkaSubscription>(clients_for(options.priority).consuming, topic, all, std::move(handler),
                                               [this, dead_letter = all.dead_letter] {
                                                 // A rejected message is settled only when the broker has confirmed its
                                                 // dead letter. So this waits for the letters: otherwise the next
                                                 // reader would get the rejected messages, too.
                                                 if (state() == ConnectionState::connected)
                                                   dead_letters_.drain(dead_letter, options_.broker.rpc_timeout);
                                               });
  }

  std::unique_ptr<PartitionWatch> watch_partitions(const Topic& topic, const std::function<void(int)>& told) override {
    check_topic(topic.name);
    return std::make_unique<KafkaPartitionWatch>(partition_counts_, topic.name, told);
  }

  ConnectionState state() const override {
    const ConnectionState reading = normal_.consuming.state();
    return reading == ConnectionState::connected ? normal_.publishing.state() : reading;
  }

  std::string problem() const override { return log_.problem(); }
  const std::string& url() const override { return url_; }

 private:
  /// Producer and groups with their own connections.
  struct PriorityClients {
    explicit PriorityClients(KafkaBroker& broker)
        : publishing(broker.options_, broker.meters_, broker.clock_, broker.log_),
          consuming(broker.options_, broker.meters_, broker.clock_, broker.log_) {}
    Producer publishing;
    ConsumerGroups consuming;
  };

  PriorityClients& clients_for(std::uint8_t priority) {
    if (priority < urgent_priority) return normal_;
    const config::MutexLock lock(mutex_);
    if (!urgent_) urgent_ = std::make_unique<PriorityClients>(*this);
    return *urgent_;
  }

  const std::string url_;
  const KafkaOptions options_;
  Meters meters_;
  const config::Clock& clock_;
  ConnectionLog log_;
  PriorityClients normal_;
  PartitionCounts partition_counts_;
  config::Mutex mutex_;
  std::unique_ptr<PriorityClients> urgent_
      IOTCLOUD_GUARDED_BY(mutex_);   ///< for urgent channels; made when first needed
  DeadLetters dead_letters_{*this};  ///< declared last, so that its publishers are destroyed before the connections
};

}  // namespace

std::unique_ptr<Broker> make_kafka_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  return std::make_unique<KafkaBroker>(options, urls);
}

}  // namespace iotcloud::brokers::kafka
