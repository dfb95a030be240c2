#include <algorithm>

#include <iotcloud/topology/endpoints/channel_sender.h>

namespace iotcloud::topology {

void SenderMeters::lost(const std::string& reason) {
  config::Labels labels = labels_;
  labels["reason"] = reason;
  metrics_.counter("iotcloud_bolt_lost_total", "Messages that did not reach their channel, by reason", labels).add();
}

std::shared_ptr<ChannelSender> ChannelSender::open(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic,
                                                   brokers::PublisherOptions options,
                                                   std::shared_ptr<SenderMeters> meters,
                                                   std::shared_ptr<const Fence> fence) {
  std::shared_ptr<ChannelSender> sender(new ChannelSender(meters, fence));
  options.void_before = [fence] { return fence->since(); };
  options.on_outcome = [meters](std::uint64_t, brokers::Outcome outcome, const std::string& reason) {
    if (outcome == brokers::Outcome::confirmed) return;
    meters->lost(outcome == brokers::Outcome::refused   ? "refused"
                 : outcome == brokers::Outcome::unknown ? "unknown"
                                                        : reason);
  };
  options.on_writable = [weak = std::weak_ptr(sender)] {
    if (const auto self = weak.lock()) self->on_writable();
  };
  std::shared_ptr<brokers::Publisher> publisher = broker->publisher(topic, options);
  const std::lock_guard lock(sender->mutex_);
  sender->broker_ = std::move(broker);
  sender->publisher_ = std::move(publisher);
  return sender;
}

void ChannelSender::send(brokers::Message message, const Tuple& tuple, OutputCollector& collector) {
  std::unique_lock lock(mutex_);
  if (!publisher_ || held_.size() >= most_held) {
    const bool closed = !publisher_;
    lock.unlock();
    meters_->lost(closed ? "closed" : "held_back");
    collector.fail(tuple);
    return;
  }
  held_.push_back({std::move(message), tuple, &collector});
  if (!full_ && sending_ == nullptr) pump(lock);
}

/// Sends what is held until nothing is left or the publisher is full. One thread at a time; the lock is not held while
/// the publisher and the collector are called.
void ChannelSender::pump(std::unique_lock<std::mutex>& lock) {
  while (!held_.empty() && publisher_) {
    Held held = std::move(held_.front());
    held_.pop_front();
    const auto publisher = publisher_;
    sending_ = held.collector;
    writable_again_ = false;
    lock.unlock();
    const bool is_void = this->is_void(held.tuple);
    const auto status = is_void ? brokers::PublishStatus::closed : publisher->publish(held.message);
    if (status == brokers::PublishStatus::accepted) {
      meters_->accepted();
      held.collector->ack(held.tuple);
    } else if (status == brokers::PublishStatus::closed) {
      meters_->lost(is_void ? "fenced" : "closed");
      held.collector->fail(held.tuple);
    }
    lock.lock();
    sending_ = nullptr;
    sent_.notify_all();
    if (status != brokers::PublishStatus::would_block) continue;
    held_.push_front(std::move(held));
    if (!writable_again_) {
      full_ = true;
      return;
    }
  }
}

/// Whether the tuple comes from a message that its broker has given to another reader. One of unknown age is not.
bool ChannelSender::is_void(const Tuple& tuple) const {
  const std::int64_t born = tuple.data()->born_ns;
  return born != 0 && fence_->voids(Fence::Instant(std::chrono::nanoseconds(born)));
}

void ChannelSender::on_writable() {
  std::unique_lock lock(mutex_);
  full_ = false;
  if (sending_ != nullptr) {
    writable_again_ = true;
    return;
  }
  pump(lock);
}

void ChannelSender::reset_timeouts() {
  const std::lock_guard lock(mutex_);
  for (const auto& held : held_) held.collector->reset_timeout(held.tuple);
}

void ChannelSender::forget(const OutputCollector& collector) {
  std::deque<Held> gone;
  std::unique_lock lock(mutex_);
  sent_.wait(lock, [&] { return sending_ != &collector; });
  std::deque<Held> kept;
  for (auto& held : held_) (held.collector == &collector ? gone : kept).push_back(std::move(held));
  held_ = std::move(kept);
}

void ChannelSender::close() {
  std::shared_ptr<brokers::Broker> broker;
  std::shared_ptr<brokers::Publisher> publisher;
  std::deque<Held> held;
  {
    const std::lock_guard lock(mutex_);
    broker = std::move(broker_);
    publisher = std::move(publisher_);
    held.swap(held_);
  }
  publisher.reset();
  for (const auto& [message, tuple, collector] : held) {
    meters_->lost("closed");
    collector->fail(tuple);
  }
}

}  // namespace iotcloud::topology
