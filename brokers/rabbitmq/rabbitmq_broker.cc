#include "iotcloud/brokers/rabbitmq/rabbitmq_broker.h"

#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/consume_link.h"
#include "iotcloud/brokers/rabbitmq/publish_link.h"
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
  RabbitMqSubscription(ConsumeLink& link, const Topic& topic, const SubscriptionOptions& options, Handler handler)
      : link_(link), inlet_(link.add(topic, options, std::move(handler))) {}
  ~RabbitMqSubscription() override { link_.remove(inlet_); }
  void pause() override { link_.pause(*inlet_); }
  void resume() override { link_.resume(inlet_); }
  bool active() const override { return link_.active(*inlet_); }

 private:
  ConsumeLink& link_;
  const std::shared_ptr<Inlet> inlet_;
};

/// The third thread of a broker object: looks after connections whose own threads may be stuck in a handler or a send.
class Keeper {
 public:
  Keeper(PublishLink& publishing, ConsumeLink& consuming) {
    thread_ = std::thread([this, &publishing, &consuming] {
      std::unique_lock lock(mutex_);
      // By the system's clock: the other kind of wait is not known to the thread sanitizer.
      while (!stop_.wait_until(lock, std::chrono::system_clock::now() + period, [this] { return stopping_; })) {
        publishing.watch();
        consuming.attend();
      }
    });
    pthread_setname_np(thread_.native_handle(), "amqp-keeper");
  }
  ~Keeper() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    stop_.notify_all();
    thread_.join();
  }
  Keeper(const Keeper&) = delete;
  Keeper& operator=(const Keeper&) = delete;

 private:
  static constexpr std::chrono::milliseconds period{250};
  std::mutex mutex_;
  std::condition_variable stop_;
  bool stopping_ = false;  ///< guarded by mutex_
  std::thread thread_;
};

class RabbitMqBroker final : public Broker {
 public:
  RabbitMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : url_(options.urls.front()),
        meters_(options.metrics, "rabbitmq"),
        log_(printable_url(options.urls.front())),
        publishing_(link_options(options, urls, "publishing"), meters_, clock_of(options), log_),
        consuming_(
            std::make_shared<ConsumeLink>(link_options(options, urls, "consuming"), meters_, clock_of(options), log_)),
        keeper_(publishing_, *consuming_) {}
  ~RabbitMqBroker() override { consuming_->close(); }

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check_name(topic.name, "topic");
    return std::make_unique<RabbitMqPublisher>(publishing_, topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check_name(topic.name, "topic");
    check_name(options.group.empty() ? topic.name : topic.name + "." + options.group, "queue");
    return std::make_unique<RabbitMqSubscription>(*consuming_, topic, options,
                                                  dead_letters_.guard(topic, options, std::move(handler)));
  }

  ConnectionState state() const override {
    const ConnectionState reading = consuming_->state();
    return reading == ConnectionState::connected ? publishing_.state() : reading;
  }

  const std::string& url() const override { return url_; }

 private:
  static LinkOptions link_options(const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                                  const char* purpose) {
    return {urls.front(), options.heartbeat, options.rpc_timeout, purpose};
  }
  static const config::Clock& clock_of(const BrokerOptions& options) {
    return options.clock != nullptr ? *options.clock : config::system_clock();
  }

  const std::string url_;
  Meters meters_;
  ConnectionLog log_;
  PublishLink publishing_;
  const std::shared_ptr<ConsumeLink> consuming_;
  Keeper keeper_;
  DeadLetters dead_letters_{*this};  ///< its publishers die before the connections
};

}  // namespace

std::unique_ptr<Broker> make_rabbitmq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  return std::make_unique<RabbitMqBroker>(options, urls);
}

}  // namespace iotcloud::brokers::rabbitmq
