#include <algorithm>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

std::shared_ptr<TopicReader> TopicReader::open(std::shared_ptr<brokers::Broker> broker,
                                               const brokers::BrokerAddress& address, const brokers::Topic& topic,
                                               const brokers::SubscriptionOptions& options, Sender sender,
                                               std::shared_ptr<SpoutQueue> queue,
                                               std::shared_ptr<const StandstillFence> fence,
                                               std::shared_ptr<HeldMessages> held) {
  const std::int32_t partition = options.partition.value_or(0);
  std::shared_ptr<TopicReader> reader(
      new TopicReader(topic, partition == 0 ? topic.name : topic.name + "#" + std::to_string(partition), address,
                      std::move(sender), std::move(queue), std::move(fence), std::move(held), options));
  const auto handler = [weak = std::weak_ptr(reader)](brokers::Delivery delivery) {
    if (const auto self = weak.lock()) self->take(std::move(delivery));
  };
  auto subscription = broker->subscribe(topic, options, handler);
  {
    const config::MutexLock lock(reader->mutex_);
    reader->broker_ = std::move(broker);
    reader->subscription_ = std::move(subscription);
    // the handler may have run, and paused this reader, before subscription_ was set
    if (reader->paused_ || reader->draining_) reader->subscription_->pause();
  }
  reader->raise_prefetch();  // bolts may keep all that has come before there was a subscription_
  return reader;
}

void TopicReader::take(brokers::Delivery delivery) {
  if (is_void()) {  // kept until close(): if it were returned now, the broker would deliver it again at once
    const config::MutexLock lock(mutex_);
    if (!closed_) withheld_.push_back(std::move(delivery));
    return;
  }
  if (!said_first_.exchange(true, std::memory_order_relaxed)) {
    endpoints_logger.debug("{}: its first message is here", name_);
  }
  ++taken_;
  queue_->push(ChannelMessage(std::move(delivery), shared_from_this()));
}

void TopicReader::raise_prefetch() {
  const std::size_t now = prefetch_, in_hand = in_hand_;
  // Messages that wait for the spout do not count, because more of them would be of no use.
  if (now >= prefetch_limit_ || in_hand < now / 2 || in_hand == 0) return;
  if (in_hand - std::min(in_hand, queue_->size()) < now / 2) return;
  const std::size_t wanted = std::min(now * 2, prefetch_limit_);
  if (!held_->has_room(bytes_ / in_hand * (wanted - now))) return;
  const config::MutexLock lock(mutex_);
  if (!subscription_ || !subscription_->raise_prefetch(static_cast<std::uint16_t>(wanted))) return;
  prefetch_ = wanted;
  endpoints_logger.debug("{}: bolts keep its messages, so that its prefetch is {} now", name_, wanted);
}

void TopicReader::ask_backlog() {
  const config::MutexLock lock(mutex_);
  backlog_ = subscription_ ? subscription_->backlog() : std::nullopt;
}

std::optional<std::uint64_t> TopicReader::backlog() const {
  const config::MutexLock lock(mutex_);
  return backlog_;
}

void TopicReader::pause() {
  const config::MutexLock lock(mutex_);
  paused_ = true;
  if (subscription_) subscription_->pause();
}

void TopicReader::resume() {
  const config::MutexLock lock(mutex_);
  paused_ = false;
  if (subscription_ && !draining_) subscription_->resume();
}

void TopicReader::drain() {
  const config::MutexLock lock(mutex_);
  draining_ = true;
  if (subscription_) subscription_->pause();
}

void TopicReader::close() {
  std::shared_ptr<brokers::Broker> broker;
  std::unique_ptr<brokers::Subscription> subscription;
  {
    const config::MutexLock lock(mutex_);
    closed_ = true;
    broker = std::move(broker_);
    subscription = std::move(subscription_);
  }
  subscription.reset();
  std::vector<brokers::Delivery> withheld;
  {
    const config::MutexLock lock(mutex_);
    withheld.swap(withheld_);
  }
  queue_->forget(*this);
}

bool TopicReader::closed() const {
  const config::MutexLock lock(mutex_);
  return closed_;
}

bool TopicReader::active() const {
  const config::MutexLock lock(mutex_);
  return subscription_ && subscription_->active();
}

}  // namespace iotcloud::topology
