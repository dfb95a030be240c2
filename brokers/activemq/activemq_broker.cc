#include "iotcloud/brokers/activemq/activemq_broker.h"

#include <exception>
#include <mutex>
#include <thread>
#include <utility>

#include <proton/container.hpp>
#include <pthread.h>

#include "iotcloud/brokers/activemq/consume_link.h"
#include "iotcloud/brokers/activemq/publish_link.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

/// Proton's container with its one thread, on which everything of proton's happens.
class Io {
 public:
  Io() {
    container_.auto_stop(false);
    thread_ = std::thread([this] {
      try {
        container_.run();
      } catch (const std::exception& error) {
        logger.error("the connections to ActiveMQ ended: {}", error.what());
      }
    });
    pthread_setname_np(thread_.native_handle(), "amqp10-io");
  }
  ~Io() { stop(); }
  Io(const Io&) = delete;
  Io& operator=(const Io&) = delete;

  void stop() {
    if (!thread_.joinable()) return;
    container_.stop();
    thread_.join();
  }
  proton::container& container() { return container_; }

 private:
  proton::container container_;
  std::thread thread_;
};

class ActiveMqPublisher final : public Publisher {
 public:
  ActiveMqPublisher(PublishLink& link, const Topic& topic, const PublisherOptions& options)
      : link_(link), outlet_(link.add(topic, options)) {}
  ~ActiveMqPublisher() override { link_.remove(outlet_); }
  PublishStatus publish(Message message) override { return link_.publish(outlet_, std::move(message)); }
  PublishStatus publish_again(Message message, const Past& past) override {
    return link_.publish(outlet_, std::move(message), past);
  }
  bool drain(std::chrono::milliseconds limit) override { return link_.drain(outlet_, limit); }
  std::size_t pending() const override { return link_.pending(*outlet_); }

 private:
  PublishLink& link_;
  const std::shared_ptr<Outlet> outlet_;
};

class ActiveMqSubscription final : public Subscription {
 public:
  ActiveMqSubscription(ConsumeLink& link, const Topic& topic, const SubscriptionOptions& options, Handler handler)
      : link_(link), inlet_(link.add(topic, options, std::move(handler))) {}
  ~ActiveMqSubscription() override { link_.remove(inlet_); }
  void pause() override { link_.pause(*inlet_); }
  void resume() override { link_.resume(inlet_); }
  bool active() const override { return link_.active(*inlet_); }

 private:
  ConsumeLink& link_;
  const std::shared_ptr<Inlet> inlet_;
};

/// Bulk data and urgent messages have connections of their own; those for urgent ones are made when first used.
class ActiveMqBroker final : public Broker {
 public:
  ActiveMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : options_(options),
        meters_(options.metrics, "activemq"),
        log_(printable_url(options.urls.front())),
        publishing_(io_.container(), options_, urls, "publishing", meters_, log_),
        urgent_publishing_(io_.container(), options_, urls, "publishing-urgent", meters_, log_),
        consuming_(std::make_shared<ConsumeLink>(io_.container(), options_, urls, "consuming", meters_, log_)),
        urgent_consuming_(
            std::make_shared<ConsumeLink>(io_.container(), options_, urls, "consuming-urgent", meters_, log_)) {
    publishing_.start();
  }
  ~ActiveMqBroker() override {
    consuming_->end();
    urgent_consuming_->end();
    dead_letters_.reset();
    publishing_.close();
    urgent_publishing_.close();
    io_.stop();
  }

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check(topic);
    return std::make_unique<ActiveMqPublisher>(options.priority >= urgent_priority ? urgent_publishing_ : publishing_,
                                               topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check(topic);
    return std::make_unique<ActiveMqSubscription>(
        options.priority >= urgent_priority ? *urgent_consuming_ : *consuming_, topic, options,
        dead_letters_->guard(topic, options, std::move(handler)));
  }

  ConnectionState state() const override {
    for (const ConnectionState reading : {consuming_->state(), urgent_consuming_->state()}) {
      if (reading != ConnectionState::connected) return reading;
    }
    return publishing_.state();
  }

  const std::string& url() const override { return options_.urls.front(); }

 private:
  static void check(const Topic& topic) {
    if (topic.name.empty()) throw config::Error("a topic on ActiveMQ needs a name");
  }

  const BrokerOptions options_;
  Meters meters_;
  ConnectionLog log_;
  Io io_;
  PublishLink publishing_;
  PublishLink urgent_publishing_;
  const std::shared_ptr<ConsumeLink> consuming_;
  const std::shared_ptr<ConsumeLink> urgent_consuming_;
  std::unique_ptr<DeadLetters> dead_letters_ = std::make_unique<DeadLetters>(*this);
};

}  // namespace

std::unique_ptr<Broker> make_activemq_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  if (!options.properties.empty()) {
    throw config::Error("ActiveMQ knows no property \"" + options.properties.begin()->first + "\"; it has none");
  }
  return std::make_unique<ActiveMqBroker>(options, urls);
}

}  // namespace iotcloud::brokers::activemq
