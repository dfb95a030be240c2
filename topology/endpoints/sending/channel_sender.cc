#include <algorithm>

#include <iotcloud/topology/endpoints/sending/channel_sender.h>

namespace iotcloud::topology {

namespace {

/// The answer for a tuple by what became of its message. It is acked if the broker confirmed the message, or the
/// channel's policy dropped it. A fenced message must not be: another worker may have it by now.
ChannelSender::Answer answer_to(brokers::Outcome outcome, const std::string& reason) {
  using Answer = ChannelSender::Answer;
  switch (outcome) {
    case brokers::Outcome::confirmed:
      return Answer::ack;
    case brokers::Outcome::refused:
      return Answer::fail;
    case brokers::Outcome::dropped:
      return reason == "fenced" ? Answer::retry : Answer::ack;
    case brokers::Outcome::unknown:
      break;
  }
  return Answer::retry;
}

}  // namespace

void SenderMeters::lost(const std::string& reason) {
  config::Labels labels = labels_;
  labels["reason"] = reason;
  metrics_.counter("iotcloud_bolt_lost_total", "Messages that did not reach their channel, by reason", labels).add();
}

std::shared_ptr<ChannelSender> ChannelSender::open(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic,
                                                   brokers::PublisherOptions options, AckWhen ack_when,
                                                   const std::shared_ptr<SenderMeters>& meters,
                                                   const std::shared_ptr<const StandstillFence>& fence) {
  std::shared_ptr<ChannelSender> sender(new ChannelSender(ack_when, meters, fence));
  options.void_before = [fence] { return fence->since(); };
  options.on_outcome = [meters, weak = std::weak_ptr(sender)](std::uint64_t number, brokers::Outcome outcome,
                                                              const std::string& reason) {
    if (outcome != brokers::Outcome::confirmed) {
      meters->lost(outcome == brokers::Outcome::refused   ? "refused"
                   : outcome == brokers::Outcome::unknown ? "unknown"
                                                          : reason);
    }
    if (const auto self = weak.lock()) self->on_outcome(number, answer_to(outcome, reason));
  };
  options.on_writable = [weak = std::weak_ptr(sender)] {
    if (const auto self = weak.lock()) self->on_writable();
  };
  std::shared_ptr<brokers::Publisher> publisher = broker->publisher(topic, options);
  const config::MutexLock lock(sender->mutex_);
  sender->broker_ = std::move(broker);
  sender->publisher_ = std::move(publisher);
  return sender;
}

void ChannelSender::send(brokers::Message message, const Tuple& tuple, OutputCollector& collector,
                         std::chrono::milliseconds age) {
  config::UniqueLock lock(mutex_);
  if (!publisher_ || held_.size() >= most_held) {
    const bool closed = !publisher_;
    lock.unlock();
    meters_->lost(closed ? "closed" : "held_back");
    collector.retry(tuple);
    return;
  }
  held_.push_back({std::move(message), tuple, &collector, age});
  if (!full_ && sending_ == nullptr) pump();
}

/// Sends the held-back tuples until none is left or the publisher is full. Only one thread at a time runs it. It
/// releases the lock while it calls the publisher and the collector.
void ChannelSender::pump() {
  while (!held_.empty() && publisher_) {
    Held held = std::move(held_.front());
    held_.pop_front();
    auto publisher = publisher_;
    sending_ = held.collector;
    writable_again_ = false;
    // The tuple is kept before its message is published, because the outcome may come before publish() returns. An
    // untracked tuple is not kept: no spout waits for its ack.
    const bool awaited = ack_when_ == AckWhen::confirmed && held.tuple.data()->tree != nullptr;
    if (awaited) under_way_.push_back({last_number_ + 1, held.tuple, held.collector});
    brokers::Published published;
    {
      const config::Unlocked unlocked(mutex_);
      const bool is_void = this->is_void(held.tuple);
      if (!is_void) published = publisher->publish_again(held.message, {false, held.age});
      if (published == brokers::PublishStatus::accepted) {
        meters_->accepted();
        if (!awaited) held.collector->ack(held.tuple);
      } else if (published == brokers::PublishStatus::closed) {
        meters_->lost(is_void ? "fenced" : "closed");
        held.collector->retry(held.tuple);
      }
      // If close() ran meanwhile, this is the last reference, whose destructor reports outcomes: on_outcome() takes the
      // lock.
      publisher.reset();
    }
    if (published == brokers::PublishStatus::accepted) {
      last_number_ = published.number;
    } else if (awaited) {
      under_way_.pop_back();
    }
    const bool waits = published == brokers::PublishStatus::would_block;
    const bool too_late = waits && !publisher_;  // close() has answered what was held back, and did not see this one
    if (too_late) {
      const config::Unlocked unlocked(mutex_);
      meters_->lost("closed");
      held.collector->retry(held.tuple);
    }
    sending_ = nullptr;
    sent_.notify_all();
    if (!waits || too_late) continue;
    held_.push_front(std::move(held));
    if (!writable_again_) {
      full_ = true;
      return;
    }
  }
}

/// Whether the tuple comes from a message that the broker has delivered to another reader since. A tuple without a
/// recorded birth is never void.
bool ChannelSender::is_void(const Tuple& tuple) const {
  const std::int64_t born = tuple.data()->born_ns;
  return born != 0 && fence_->voids(StandstillFence::Instant(std::chrono::nanoseconds(born)));
}

void ChannelSender::on_outcome(std::uint64_t number, Answer answer) {
  Tuple tuple;
  OutputCollector* collector = nullptr;
  {
    const config::MutexLock lock(mutex_);
    const auto found = std::lower_bound(under_way_.begin(), under_way_.end(), number,
                                        [](const UnderWay& one, std::uint64_t sought) { return one.number < sought; });
    if (found == under_way_.end() || found->number != number) return;
    tuple = std::move(found->tuple);
    collector = std::exchange(found->collector, nullptr);
    while (!under_way_.empty() && under_way_.front().collector == nullptr) under_way_.pop_front();
    if (collector == nullptr) return;
    answering_.push_back(collector);
  }
  switch (answer) {
    case Answer::ack:
      collector->ack(tuple);
      break;
    case Answer::fail:
      collector->fail(tuple);
      break;
    case Answer::retry:
      collector->retry(tuple);
      break;
  }
  const config::MutexLock lock(mutex_);
  answering_.erase(std::find(answering_.begin(), answering_.end(), collector));
  sent_.notify_all();
}

void ChannelSender::on_writable() {
  const config::MutexLock lock(mutex_);
  full_ = false;
  if (sending_ != nullptr) {
    writable_again_ = true;
    return;
  }
  pump();
}

void ChannelSender::reset_timeouts() {
  const config::MutexLock lock(mutex_);
  for (const auto& held : held_) held.collector->reset_timeout(held.tuple);
  for (const auto& one : under_way_) {
    if (one.collector != nullptr) one.collector->reset_timeout(one.tuple);
  }
}

void ChannelSender::forget(const OutputCollector& collector) {
  std::deque<Held> gone;
  std::deque<Tuple> forgotten;
  const config::MutexLock lock(mutex_);
  sent_.wait(mutex_, [&]() IOTCLOUD_REQUIRES(mutex_) {
    return sending_ != &collector && std::count(answering_.begin(), answering_.end(), &collector) == 0;
  });
  for (auto& one : under_way_) {
    if (one.collector != &collector) continue;
    one.collector = nullptr;
    forgotten.push_back(std::move(one.tuple));
  }
  std::deque<Held> kept;
  for (auto& held : held_) (held.collector == &collector ? gone : kept).push_back(std::move(held));
  held_ = std::move(kept);
}

void ChannelSender::close() {
  std::shared_ptr<brokers::Broker> broker;
  std::shared_ptr<brokers::Publisher> publisher;
  std::deque<Held> held;
  {
    const config::MutexLock lock(mutex_);
    broker = std::move(broker_);
    publisher = std::move(publisher_);
    held.swap(held_);
  }
  publisher.reset();
  for (const auto& one : held) {
    meters_->lost("closed");
    one.collector->retry(one.tuple);
  }
}

}  // namespace iotcloud::topology
