#include "iotcloud/brokers/activemq/activemq_broker.h"

#include <utility>

#include "iotcloud/brokers/activemq/io_loop.h"
#include "iotcloud/brokers/activemq/receiver_link.h"
#include "iotcloud/brokers/activemq/sender_link.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::activemq {
namespace {

class ActiveMqSubscription final : public Subscription {
 public:
  ActiveMqSubscription(ReceiverLink& link, const Topic& topic, const SubscriptionOptions& options, Handler handler)
      : link_(link), reader_(link.add(topic, options, std::move(handler))) {}
  ~ActiveMqSubscription() override { link_.remove(reader_); }
  void pause() override { link_.pause(*reader_); }
  void resume() override { link_.resume(*reader_); }
  bool raise_prefetch(std::uint16_t prefetch) override { return link_.raise_prefetch(*reader_, prefetch); }
  bool active() const override { return link_.active(*reader_); }

 private:
  ReceiverLink& link_;
  const std::shared_ptr<SessionReader> reader_;
};

/// Normal and urgent messages have separate connections and threads; those for urgent messages are started when first
/// used.
class ActiveMqBroker final : public Broker {
 public:
  ActiveMqBroker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls)
      : options_(options),
        meters_(options.metrics, "activemq"),
        log_(printable_url(options.urls.front())),
        trust_(options.tls.ca_file, options.tls.revoked_file),
        loop_(clock_of(options)),
        urgent_loop_(clock_of(options)),
        publishing_(loop_, options_, urls, "publishing", meters_, log_, trust_),
        urgent_publishing_(urgent_loop_, options_, urls, "publishing-urgent", meters_, log_, trust_),
        consuming_(std::make_shared<ReceiverLink>(loop_, options_, urls, "consuming", meters_, log_, trust_)),
        urgent_consuming_(
            std::make_shared<ReceiverLink>(urgent_loop_, options_, urls, "consuming-urgent", meters_, log_, trust_)) {
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
    SenderLink& link = options.priority >= urgent_priority ? urgent_publishing_ : publishing_;
    return std::make_unique<client::CorePublisher>(link.core(), topic, options);
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

  std::string problem() const override { return log_.problem(); }
  const std::string& url() const override { return options_.urls.front(); }

 private:
  void start_urgent() { urgent_loop_.start({&urgent_publishing_, urgent_consuming_.get()}); }
  static void check(const Topic& topic) {
    if (topic.name.empty()) throw config::Error("a topic on ActiveMQ needs a name");
  }

  const BrokerOptions options_;
  Meters meters_;
  ConnectionLog log_;
  ServerTrust trust_;
  IoLoop loop_;
  IoLoop urgent_loop_;
  SenderLink publishing_;
  SenderLink urgent_publishing_;
  const std::shared_ptr<ReceiverLink> consuming_;
  const std::shared_ptr<ReceiverLink> urgent_consuming_;
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
