#include "iotcloud/brokers/embedded/queue.h"

#include <algorithm>

namespace iotcloud::brokers::embedded {
namespace {

/// How many bytes of queue_bytes_limit a message counts for: its payload and an estimate for the rest.
std::size_t cost(const StoredMessage& stored) {
  return stored.message.payload.size() + 256;
}

}  // namespace

bool Consumer::can_take() const {
  return active && !paused && !closed && queue && queue->size() > 0 &&
         (options.automatic_ack || unsettled.size() < std::max<std::size_t>(options.prefetch, 1));
}

void Queue::push(Message message, std::optional<Instant> expires, bool possibly_redelivered) {
  items_.push_back(StoredMessage{std::move(message), ++last_sequence_, expires, possibly_redelivered});
  bytes_ += cost(items_.back());
}

void Queue::put_back(StoredMessage stored) {
  stored.redelivered = true;
  bytes_ += cost(stored);
  const auto place =
      std::lower_bound(items_.begin(), items_.end(), stored.sequence,
                       [](const StoredMessage& item, std::uint64_t sequence) { return item.sequence < sequence; });
  items_.insert(place, std::move(stored));
}

std::optional<StoredMessage> Queue::pop(Instant now) {
  while (!items_.empty()) {
    StoredMessage first = std::move(items_.front());
    items_.pop_front();
    bytes_ -= cost(first);
    if (!first.expires || *first.expires > now) return first;
  }
  return std::nullopt;
}

std::size_t Queue::trim(std::size_t keep) {
  std::size_t dropped = 0;
  for (; items_.size() > keep; ++dropped) {
    bytes_ -= cost(items_.front());
    items_.pop_front();
  }
  return dropped;
}

std::size_t Queue::unsettled() const {
  std::size_t total = 0;
  for (const auto& reader : readers_) total += reader->unsettled.size();
  return total;
}

void Queue::attach(const std::shared_ptr<Consumer>& consumer) {
  readers_.push_back(consumer);
  activate();
}

void Queue::detach(Consumer& consumer, Instant now) {
  std::erase_if(readers_, [&](const auto& reader) { return reader.get() == &consumer; });
  consumer.active = false;
  for (auto& [tag, stored] : consumer.unsettled) {
    stored.tries = 0;
    put_back(std::move(stored));
  }
  consumer.unsettled.clear();
  if (readers_.empty()) unused_since_ = now;
  activate();
}

void Queue::activate() {
  bool any = std::any_of(readers_.begin(), readers_.end(), [](const auto& reader) { return reader->active; });
  for (const auto& reader : readers_) {
    if (reader->active && reader->options.exclusive) return;
    if (reader->active || (reader->options.exclusive && any)) continue;
    reader->active = any = true;
    if (reader->options.exclusive) return;
  }
}

}  // namespace iotcloud::brokers::embedded
