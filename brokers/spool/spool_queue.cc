#include "iotcloud/brokers/spool/spool_queue.h"

#include <algorithm>
#include <cstring>
#include <exception>
#include <utility>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::spool {
namespace {

const config::Logger logger{"brokers.spool"};

// At the inner publisher, and so in memory, at a time.
constexpr std::size_t most_bytes_under_way = std::size_t{16} << 20;
// The mark is written after so many outcomes, or when nothing is under way: a kill in between makes duplicates.
constexpr std::uint64_t outcomes_per_mark = 64;
constexpr std::chrono::seconds disk_retry{1};
// Of one spool before the others have their turn.
constexpr int records_per_turn = 256;

SpoolStore::Options store_options(const SpoolOptions& spool) {
  SpoolStore::Options options;
  options.folder = spool.folder;
  options.max_bytes = spool.max_bytes;
  options.disk = spool.disk;
  switch (spool.sync) {
    case SpoolSync::never:
      options.sync = Sync::never;
      break;
    case SpoolSync::interval:
      options.sync = Sync::interval;
      break;
    case SpoolSync::always:
      options.sync = Sync::always;
      break;
  }
  return options;
}

/// Holds the right to hand messages to the inner publisher; gives it back under the mutex.
class Sending {
 public:
  Sending(bool& sending, std::unique_lock<std::mutex>& lock) : sending_(sending), lock_(lock) { sending_ = true; }
  Sending(const Sending&) = delete;
  Sending& operator=(const Sending&) = delete;
  ~Sending() {
    if (!lock_.owns_lock()) lock_.lock();
    sending_ = false;
  }

 private:
  bool& sending_;
  std::unique_lock<std::mutex>& lock_;
};

PublisherOptions with_some_capacity(PublisherOptions options) {
  options.capacity = std::max<std::size_t>(options.capacity, 1);
  return options;
}

}  // namespace

SpoolQueue::SpoolQueue(const Topic& topic, const PublisherOptions& options, const SpoolOptions& spool)
    : topic_(topic),
      options_(with_some_capacity(options)),
      spool_(spool),
      clock_(spool.clock != nullptr ? *spool.clock : config::system_clock()),
      store_(store_options(spool)),
      ledger_(store_.mark(), store_.next_sequence()),
      meters_(spool.metrics, spool.labels) {
  tell_found();
}

void SpoolQueue::tell_found() {
  const SpoolStore::Found& found = store_.found();
  if (found.messages > 0)
    logger.info("{}: {} message(s) of an earlier process are sent", spool_.folder, found.messages);
  if (found.torn_bytes > 0) {
    logger.warn("{}: the last record was not complete and is cut off ({} bytes)", spool_.folder, found.torn_bytes);
  }
  if (found.damaged_bytes > 0) {
    logger.error("{}: the end is damaged and is cut off ({} bytes, kept in a file whose name ends in .damaged)",
                 spool_.folder, found.damaged_bytes);
  }
  if (found.missing_messages > 0) {
    logger.error("{}: the files of {} message(s) are gone", spool_.folder, found.missing_messages);
    meters_.dropped(reason::spool_damaged, found.missing_messages);
  }
  if (found.mark_lost) {
    logger.error("{}: which messages were sent is not known any more: all that are there are sent again",
                 spool_.folder);
  }
  meters_.restored(found.messages);
  meters_.torn_bytes(found.torn_bytes);
  meters_.damaged_bytes(found.damaged_bytes);
  meters_.level(found.messages, store_.bytes());
}

PublisherOptions SpoolQueue::inner_options() {
  PublisherOptions inner = options_;
  inner.when_full = WhenFull::block;
  inner.on_outcome = [weak = weak_from_this()](std::uint64_t number, Outcome outcome, const std::string& reason) {
    if (const auto self = weak.lock()) self->on_inner_outcome(number, outcome, reason);
  };
  inner.on_writable = [weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->on_inner_writable();
  };
  return inner;
}

void SpoolQueue::open(Broker& broker) {
  inner_ = broker.publisher(topic_, inner_options());
  thread_->join(*this);
  wake();
}

void SpoolQueue::close() {
  {
    Lock lock(mutex_);
    closed_ = true;
    wanted_room_.reset();
    writable_due_ = false;
  }
  thread_->leave(*this);
  {
    const Lock order(order_);  // a publish() that is under way
  }
  inner_.reset();
  Lock lock(mutex_);
  store_.raise_mark(ledger_.mark());
  ledger_.close(reason::spooled);
  if (reporting_ != std::this_thread::get_id()) changed_.wait(lock, [this] { return !reporting_; });
  report(lock);
}

std::int64_t SpoolQueue::now_ms() const {
  return clock_.wall_ms();
}

std::size_t SpoolQueue::pending() const {
  const Lock lock(mutex_);
  return ledger_.pending();
}

SpoolQueue::Stored SpoolQueue::store(const Message& message, std::int64_t now, Position& where) {
  for (;;) {
    switch (store_.append(now, message, where)) {
      case SpoolStore::Append::stored:
        if (std::exchange(disk_failing_, false)) logger.info("{}: the disk takes messages again", spool_.folder);
        return Stored::yes;
      case SpoolStore::Append::too_large:
        return Stored::never;
      case SpoolStore::Append::failed:
        if (!std::exchange(disk_failing_, true)) {
          logger.error("{}; until the disk can be written again no message is taken", store_.problem());
        }
        meters_.disk_failed();
        if (spool_.when_full == SpoolFull::block || store_.bytes() == 0) return Stored::no_room;
        break;
      case SpoolStore::Append::full:
        if (spool_.when_full == SpoolFull::block) return Stored::no_room;
        break;
    }
    const std::uint64_t kept = store_.drop_oldest();
    const Lock lock(mutex_);
    count(ledger_.drop_below(kept, reason::spool_full), reason::spool_full);
  }
}

PublishStatus SpoolQueue::publish(Message message) {
  const char* why_not = refusal(message);
  const Lock order(order_);
  {
    const Lock lock(mutex_);
    if (closed_) return PublishStatus::closed;
  }
  Position where;
  const std::int64_t now = now_ms();
  const Stored stored = why_not != nullptr ? Stored::never : store(message, now, where);
  Lock lock(mutex_);
  if (stored == Stored::never) {
    ledger_.settled_unstored(Outcome::refused, why_not != nullptr ? why_not : "larger_than_the_spool");
    wake();
    return PublishStatus::accepted;
  }
  if (stored == Stored::no_room) {
    wake();
    if (spool_.when_full == SpoolFull::block) {
      wanted_room_ = store_.last_size();
      if (disk_failing_) retry_at_ = std::chrono::system_clock::now() + disk_retry;
      return PublishStatus::would_block;
    }
    ledger_.settled_unstored(Outcome::dropped, reason::spool_failed);
    count(1, reason::spool_failed);
    return PublishStatus::accepted;
  }
  const bool next = !sending_ && ledger_.all_sent();
  ledger_.stored();
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
  if (spool_.sync == SpoolSync::interval && !std::exchange(dirty_, true)) {
    sync_at_ = std::chrono::system_clock::now() + spool_.interval;
    wake();
  }
  if (ledger_.has_events()) wake();
  if (next) {
    wait_from_ = where;
    if (may_send()) {
      {
        const Sending sending(sending_, lock);
        if (send(std::move(message), {}, lock)) wait_from_.reset();
      }
      if (!ledger_.all_sent() && may_send()) wake();
    }
  }
  return PublishStatus::accepted;
}

bool SpoolQueue::may_send() const {
  return !closed_ && !inner_full_ && ledger_.under_way() < options_.capacity &&
         (ledger_.under_way() == 0 || ledger_.under_way_bytes() < most_bytes_under_way);
}

bool SpoolQueue::send(Message message, const Past& past, Lock& lock) {
  ledger_.send(message.payload.size());
  inner_full_ = true;  // before, because on_writable may come before the answer is seen here
  lock.unlock();
  const PublishStatus status = inner_->publish_again(std::move(message), past);
  lock.lock();
  if (status == PublishStatus::accepted) {
    inner_full_ = false;
    return true;
  }
  if (ledger_.unsend(reason::spool_full)) count(1, reason::spool_full);
  return false;
}

std::optional<Record> SpoolQueue::next_waiting(Lock& lock) {
  while (!ledger_.all_sent()) {
    if (const auto from = std::exchange(wait_from_, std::nullopt)) {
      held_.reset();
      reader_.seek(*from);
    }
    const std::uint64_t end = ledger_.next();
    lock.unlock();
    std::optional<Record> record = held_ ? std::exchange(held_, std::nullopt) : reader_.next();
    const std::uint64_t damaged_bytes = reader_.take_damaged_bytes();
    lock.lock();
    meters_.damaged_bytes(damaged_bytes);
    const std::uint64_t lost = ledger_.drop_below(record ? record->sequence : end, reason::spool_damaged);
    if (lost > 0) {
      logger.error("{}: {} message(s) cannot be read any more and are lost", spool_.folder, lost);
      count(lost, reason::spool_damaged);
    }
    if (!record || record->sequence < ledger_.unsent()) continue;
    if (options_.deadline.count() > 0 && now_ms() - record->accepted_ms >= options_.deadline.count()) {
      count(ledger_.drop_below(record->sequence + 1, reason::deadline), reason::deadline);
      continue;
    }
    return record;
  }
  return std::nullopt;
}

void SpoolQueue::send_waiting(Lock& lock) {
  if (sending_) return;  // it wakes this thread when something is left
  const Sending sending(sending_, lock);
  for (int i = 0; i < records_per_turn && may_send(); ++i) {
    std::optional<Record> record = next_waiting(lock);
    if (!record) break;
    Past past;
    past.possibly_sent = ledger_.is_old(record->sequence);
    past.age = std::chrono::milliseconds(std::max<std::int64_t>(now_ms() - record->accepted_ms, 0));
    if (ledger_.unsent() != record->sequence) continue;
    Message message = record->message;
    if (!send(std::move(message), past, lock)) held_ = std::move(record);
  }
}

void SpoolQueue::on_inner_outcome(std::uint64_t number, Outcome outcome, const std::string& reason) {
  Lock lock(mutex_);
  ledger_.answered(number, outcome, reason);
  if (++unwritten_marks_ >= outcomes_per_mark || ledger_.under_way() == 0) {
    unwritten_marks_ = 0;
    store_.raise_mark(ledger_.mark());
    if (wanted_room_ || store_.releasable()) wake();
  }
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
  if (!ledger_.all_sent() && ledger_.under_way() <= options_.capacity / 2) wake();
  report(lock);
}

void SpoolQueue::on_inner_writable() {
  const Lock lock(mutex_);
  inner_full_ = false;
  wake();
}

void SpoolQueue::count(std::uint64_t dropped, const char* reason) {
  if (dropped > 0) meters_.dropped(reason, dropped);
}

void SpoolQueue::report(Lock& lock) {
  if (reporting_) return;  // who reports looks again
  reporting_ = std::this_thread::get_id();
  while (ledger_.has_events() || writable_due_) {
    const std::vector<Ledger::Event> events = ledger_.take_events();
    const bool writable = std::exchange(writable_due_, false);
    lock.unlock();
    try {
      for (const Ledger::Event& event : events) {
        for (std::uint64_t i = 0; options_.on_outcome && i < event.count; ++i) {
          options_.on_outcome(event.first_number == 0 ? 0 : event.first_number + i, event.outcome, event.reason);
        }
      }
      if (writable && options_.on_writable) options_.on_writable();
    } catch (const std::exception& error) {
      logger.error("a callback of the publisher of topic {} threw: {}", topic_.name, error.what());
    } catch (...) {
      logger.error("a callback of the publisher of topic {} threw", topic_.name);
    }
    lock.lock();
    ledger_.reported(events);
    changed_.notify_all();
  }
  reporting_.reset();
  changed_.notify_all();
}

bool SpoolQueue::drain(std::chrono::milliseconds limit) {
  const auto end = std::chrono::system_clock::now() + limit;
  Lock lock(mutex_);
  return changed_.wait_until(lock, end, [this] { return ledger_.pending() == 0; });
}

void SpoolQueue::tidy(Lock& lock) {
  const bool sync = dirty_ && sync_at_ <= std::chrono::system_clock::now();
  if (sync) dirty_ = false;
  if (std::exchange(unwritten_marks_, 0) > 0) store_.raise_mark(ledger_.mark());
  lock.unlock();
  const int error = sync ? store_.sync() : 0;
  store_.release();
  lock.lock();
  if (error != 0) {
    meters_.disk_failed();
    if (!sync_failing_) logger.error("{} cannot be put on the disk: {}", spool_.folder, std::strerror(error));
  }
  if (sync) sync_failing_ = error != 0;
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
}

std::optional<Served::Time> SpoolQueue::next_time() const {
  if (!ledger_.all_sent() && may_send()) return std::chrono::system_clock::now();
  std::optional<Time> next = retry_at_;
  if (dirty_ && (!next || sync_at_ < *next)) next = sync_at_;
  return next;
}

std::optional<Served::Time> SpoolQueue::serve() noexcept {
  try {
    const auto self = shared_from_this();  // a callback may close it
    Lock lock(mutex_);
    if (closed_) return std::nullopt;
    send_waiting(lock);
    tidy(lock);
    if (retry_at_ && *retry_at_ <= std::chrono::system_clock::now()) {
      retry_at_.reset();
      writable_due_ = std::exchange(wanted_room_, std::nullopt).has_value();
    } else if (!retry_at_ && wanted_room_ && store_.has_room(*wanted_room_)) {
      wanted_room_.reset();
      writable_due_ = true;
    }
    report(lock);
    return closed_ ? std::nullopt : next_time();
  } catch (const std::exception& error) {  // memory that ran out
    logger.error("{}: {}", spool_.folder, error.what());
    return std::chrono::system_clock::now() + disk_retry;
  }
}

}  // namespace iotcloud::brokers::spool
