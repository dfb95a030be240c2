#include "iotcloud/brokers/activemq/activemq_broker.h"

#include <utility>

#include "iotcloud/brokers/activemq/connection/io_loop.h"
#include "iotcloud/brokers/activemq/consuming/consume_link.h"
#include "iotcloud/brokers/activemq/publishing/publish_link.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::activemq {
namespace {

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

const config::Clock& clock_of(const BrokerOptions& options) {
  return options.clock != nullptr ? *options.clock : config::system_clock();
}

/// Bulk data and urgent messages have connections and threads of their own; those for urgent ones begin when first
/// used.
class ActiveMqBroker final : public Broker {
 public:
  ActiveMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : options_(options),
        meters_(options.metrics, "activemq"),
        log_(printable_url(options.urls.front())),
        loop_(clock_of(options)),
        urgent_loop_(clock_of(options)),
        publishing_(loop_, options_, urls, "publishing", meters_, log_),
        urgent_publishing_(urgent_loop_, options_, urls, "publishing-urgent", meters_, log_),
        consuming_(std::make_shared<ConsumeLink>(loop_, options_, urls, "consuming", meters_, log_)),
        urgent_consuming_(
            std::make_shared<ConsumeLink>(urgent_loop_, options_, urls, "consuming-urgent", meters_, log_)) {
    publishing_.start();
    loop_.start({&publishing_, consuming_.get()});
  }
  ~ActiveMqBroker() override {
    consuming_->end();
    urgent_consuming_->end();
    dead_letters_.reset();
    publishing_.close();
    urgent_publishing_.close();
    loop_.stop();
    urgent_loop_.stop();
  }

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    check(topic);
    if (options.priority >= urgent_priority) start_urgent();
    return std::make_unique<ActiveMqPublisher>(options.priority >= urgent_priority ? urgent_publishing_ : publishing_,
                                               topic, options);
  }

  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    check(topic);
    if (options.priority >= urgent_priority) start_urgent();
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
  void start_urgent() { urgent_loop_.start({&urgent_publishing_, urgent_consuming_.get()}); }
  static void check(const Topic& topic) {
    if (topic.name.empty()) throw config::Error("a topic on ActiveMQ needs a name");
  }

  const BrokerOptions options_;
  Meters meters_;
  ConnectionLog log_;
  IoLoop loop_;
  IoLoop urgent_loop_;
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
