#include <utility>

#include <iotcloud/gateway/host/channel_queue.h>

namespace iotcloud::gateway {

namespace {

constexpr std::size_t batch = 64;  ///< most messages of one channel before other callbacks on the loop run

}  // namespace

ChannelQueue::ChannelQueue(std::shared_ptr<EventLoop> loop, std::size_t keep_last, config::Counter& superseded,
                           Deliver deliver)
    : loop_(std::move(loop)), keep_last_(keep_last), superseded_(superseded), deliver_(std::move(deliver)) {}

std::optional<ChannelQueue::Waiting> ChannelQueue::push(Waiting waiting) {
  std::deque<Waiting> dropped;
  {
    const config::MutexLock lock(mutex_);
    if (closed_) return waiting;
    waiting_.push_back(std::move(waiting));
    while (keep_last_ > 0 && waiting_.size() > keep_last_) {
      dropped.push_back(std::move(waiting_.front()));
      waiting_.pop_front();
    }
    if (!scheduled_) {
      scheduled_ = true;
      loop_->post([self = shared_from_this()] { self->drain(); });
    }
  }
  superseded_.add(dropped.size());
  if (!dropped.empty()) tally_.lost("dropped: superseded", static_cast<std::int64_t>(dropped.size()));
  for (auto& old : dropped) old.delivery.settle(brokers::Settlement::accept);
  return std::nullopt;
}

ChannelQueue::Backlog ChannelQueue::backlog(config::Clock::Instant now) const {
  const config::MutexLock lock(mutex_);
  if (waiting_.empty()) return {};
  return {waiting_.size(), std::chrono::duration_cast<std::chrono::milliseconds>(now - waiting_.front().since)};
}

void ChannelQueue::drain() {
  for (std::size_t done = 0; done < batch; ++done) {
    config::UniqueLock lock(mutex_);
    if (waiting_.empty()) {
      scheduled_ = false;
      return;
    }
    Waiting next = std::move(waiting_.front());
    waiting_.pop_front();
    lock.unlock();
    const Handled handled = deliver_(std::move(next.delivery.message), next.since);
    if (handled == Handled::not_taken) {  // close() follows, and returns it with those behind it
      lock.lock();
      waiting_.push_front(std::move(next));
      return;
    }
    if (handled == Handled::done) {
      tally_.done();
    } else {
      tally_.lost("failed: the driver threw");
    }
    next.delivery.settle(handled == Handled::done ? brokers::Settlement::accept : brokers::Settlement::reject);
  }
  loop_->post([self = shared_from_this()] { self->drain(); });
}

std::deque<ChannelQueue::Waiting> ChannelQueue::close() {
  std::deque<Waiting> waiting;
  {
    const config::MutexLock lock(mutex_);
    closed_ = true;
    waiting.swap(waiting_);
  }
  std::deque<Waiting> unseen;
  for (auto& one : waiting) {
    if (!one.passed) unseen.push_back(std::move(one));
  }
  return unseen;
}

}  // namespace iotcloud::gateway
