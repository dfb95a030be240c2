#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/receiving/channel_reader.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

}  // namespace

std::shared_ptr<ChannelReader> ChannelReader::open(std::shared_ptr<brokers::Broker> broker,
                                                   const brokers::BrokerAddress& address, const brokers::Topic& topic,
                                                   const brokers::SubscriptionOptions& options, std::string driver_id,
                                                   std::shared_ptr<Inbox> inbox, std::shared_ptr<const Fence> fence) {
  std::shared_ptr<ChannelReader> reader(
      new ChannelReader(topic, address, std::move(driver_id), std::move(inbox), std::move(fence)));
  const auto handler = [weak = std::weak_ptr(reader)](brokers::Delivery delivery) {
    if (const auto self = weak.lock()) self->take(std::move(delivery));
  };
  auto subscription = broker->subscribe(topic, options, handler);
  const std::lock_guard lock(reader->mutex_);
  reader->broker_ = std::move(broker);
  reader->subscription_ = std::move(subscription);
  if (reader->paused_ || reader->draining_) reader->subscription_->pause();  // the handler ran before this line
  return reader;
}

void ChannelReader::take(brokers::Delivery delivery) {
  if (is_void()) {  // given back at once, it would come again at once
    const std::lock_guard lock(mutex_);
    if (!closed_) withheld_.push_back(std::move(delivery));
    return;
  }
  if (!said_first_.exchange(true, std::memory_order_relaxed)) {
    logger.debug("{}: its first message is here", topic_.name);
  }
  inbox_->push(Arrival(std::move(delivery), shared_from_this()));
}

void ChannelReader::pause() {
  const std::lock_guard lock(mutex_);
  paused_ = true;
  if (subscription_) subscription_->pause();
}

void ChannelReader::resume() {
  const std::lock_guard lock(mutex_);
  paused_ = false;
  if (subscription_ && !draining_) subscription_->resume();
}

void ChannelReader::drain() {
  const std::lock_guard lock(mutex_);
  draining_ = true;
  if (subscription_) subscription_->pause();
}

void ChannelReader::close() {
  std::shared_ptr<brokers::Broker> broker;
  std::unique_ptr<brokers::Subscription> subscription;
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    broker = std::move(broker_);
    subscription = std::move(subscription_);
  }
  subscription.reset();
  std::vector<brokers::Delivery> withheld;
  {
    const std::lock_guard lock(mutex_);
    withheld.swap(withheld_);
  }
  inbox_->forget(*this);
}

bool ChannelReader::closed() const {
  const std::lock_guard lock(mutex_);
  return closed_;
}

bool ChannelReader::active() const {
  const std::lock_guard lock(mutex_);
  return subscription_ && subscription_->active();
}

}  // namespace iotcloud::topology
