#include <algorithm>

#include <iotcloud/topology/endpoints/receiving/message_traces.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

HeldReader::HeldReader(std::shared_ptr<TopicReader> reader, std::size_t bytes)
    : reader_(std::move(reader)), bytes_(bytes) {
  if (reader_) reader_->take_in_hand(bytes_);
}

HeldReader::~HeldReader() {
  if (reader_) reader_->let_go(bytes_);
}

HeldReader& HeldReader::operator=(HeldReader&& other) noexcept {
  std::swap(reader_, other.reader_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

void SpoutQueue::push(ChannelMessage arrival) {
  if (traces_ && traces_->any())
    traces_->came(arrival.delivery.message, arrival.reader->topic().name, arrival.reader->sender().driver.str());
  {
    const config::MutexLock lock(mutex_);
    if (closed_) return;
    if (waiting_.size() + 1 >= limit_ &&
        std::find(paused_.begin(), paused_.end(), arrival.reader.shared()) == paused_.end()) {
      paused_.push_back(arrival.reader.shared());
      arrival.reader->pause();  // under the lock, as resume() is, so that the two reach the reader in the right order
    }
    waiting_.push_back(std::move(arrival));
  }
  waker_.wake();
}

SpoutQueue::Taken SpoutQueue::pop() {
  Taken taken;
  {
    const config::MutexLock lock(mutex_);
    if (waiting_.empty()) return taken;
    taken.arrival = std::move(waiting_.front());
    waiting_.pop_front();
    taken.more = !waiting_.empty();
    resume_when_half_empty();
  }
  taken.arrival->reader->raise_prefetch();
  return taken;
}

void SpoutQueue::forget(const TopicReader& reader) {
  std::deque<ChannelMessage> dropped;  // its destructor gives the messages back, after the lock is released
  const config::MutexLock lock(mutex_);
  std::deque<ChannelMessage> kept;
  for (auto& arrival : waiting_)
    (arrival.reader.shared().get() == &reader ? dropped : kept).push_back(std::move(arrival));
  waiting_ = std::move(kept);
  std::erase_if(paused_, [&](const auto& paused) { return paused.get() == &reader; });
  resume_when_half_empty();
}

void SpoutQueue::close() {
  std::deque<ChannelMessage> dropped;
  std::vector<std::shared_ptr<TopicReader>> paused;
  const config::MutexLock lock(mutex_);
  closed_ = true;
  dropped.swap(waiting_);
  paused.swap(paused_);
}

std::size_t SpoutQueue::size() const {
  const config::MutexLock lock(mutex_);
  return waiting_.size();
}

void SpoutQueue::resume_when_half_empty() {
  if (waiting_.size() > limit_ / 2) return;
  for (const auto& reader : paused_) reader->resume();
  paused_.clear();
}

}  // namespace iotcloud::topology
