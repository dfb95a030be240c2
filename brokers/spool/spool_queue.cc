#include "iotcloud/brokers/spool/spool_queue.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <exception>
#include <utility>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/brokers/spool/logger.h>

namespace iotcloud::brokers::spool {
namespace {

// Limit on the payload bytes that the inner publisher has at a time, because it holds them in memory.
constexpr std::size_t most_bytes_under_way = std::size_t{16} << 20;
// The mark is written after this many outcomes, or when no message is under way. If the process is killed before that,
// the next one sends the messages of these outcomes again.
constexpr std::uint64_t outcomes_per_mark = 64;
// Pause before a disk that failed is tried again.
constexpr std::chrono::seconds disk_retry{1};
// The spools' thread sends at most this many records of one spool before it serves the other spools.
constexpr int records_per_turn = 256;

SpoolStore::Options store_options(const SpoolOptions& spool) {
  SpoolStore::Options options;
  options.folder = spool.folder;
  options.max_bytes = spool.max_bytes;
  options.disk = spool.disk;
  options.synced = spool.sync != SpoolSync::never;
  return options;
}

PublisherOptions with_some_capacity(PublisherOptions options) {
  options.capacity = std::max<std::size_t>(options.capacity, 1);
  return options;
}

}  // namespace

class SpoolQueue::Sending {
 public:
  explicit Sending(SpoolQueue& queue) IOTCLOUD_REQUIRES(queue.mutex_) : queue_(queue) { queue_.sending_ = true; }
  Sending(const Sending&) = delete;
  Sending& operator=(const Sending&) = delete;
  ~Sending() {
    queue_.mutex_.assert_held();  // also when an exception ends the scope, because Unlocked takes it again
    queue_.sending_ = false;
  }

 private:
  SpoolQueue& queue_;
};

SpoolQueue::SpoolQueue(const Topic& topic, const PublisherOptions& options, const SpoolOptions& spool)
    : topic_(topic),
      options_(with_some_capacity(options)),
      spool_(spool),
      clock_(spool.clock != nullptr ? *spool.clock : config::system_clock()),
      thread_(SpoolThread::of_process(clock_)),
      store_(store_options(spool)),
      ledger_(store_.mark(), store_.next_sequence()),
      meters_(spool.metrics, spool.labels) {
  tell_found();
}

void SpoolQueue::tell_found() {
  const SpoolStore::Found& found = store_.found();
  if (found.messages > 0)
    logger.info("{}: sending {} message(s) that an earlier process left", spool_.folder, found.messages);
  if (found.torn_bytes > 0) {
    logger.warn("{}: the last record was not complete and is cut off ({} bytes)", spool_.folder, found.torn_bytes);
  }
  if (found.damaged_bytes > 0) {
    logger.error("{}: the end is damaged and is cut off ({} bytes, kept in a file whose name ends in .damaged)",
                 spool_.folder, found.damaged_bytes);
  }
  if (found.missing_messages > 0) {
    logger.error("{}: {} message(s) are lost, because their files are gone", spool_.folder, found.missing_messages);
    meters_.dropped(reason::spool_damaged, found.missing_messages);
  }
  if (found.mark_lost) {
    logger.error(
        "{}: the file \"mark\" is damaged, so it is unknown which messages were sent: all that are there are sent "
        "again",
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
  sender_.assert_held();  // no other thread uses this object yet
  inner_ = broker.publisher(topic_, inner_options());
  thread_->add(*this);
  wake();
}

void SpoolQueue::close() {
  {
    const config::MutexLock lock(mutex_);
    closed_ = true;
    wanted_room_.reset();
    writable_due_ = false;
  }
  thread_->remove(*this);
  {
    const config::MutexLock order(order_);  // waits for a publish() that is under way
  }
  sender_.assert_held();  // no thread begins to send any more
  inner_.reset();
  std::uint64_t mark = 0;
  {
    const config::MutexLock lock(mutex_);
    mark = ledger_.mark();  // nothing moves it any more
  }
  store_.raise_mark(mark);
  const config::MutexLock lock(mutex_);
  ledger_.close(reason::spooled);
  if (reporting_ != std::this_thread::get_id()) {
    changed_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return !reporting_; });
  }
  report();
  meters_.close();  // a callback that closes keeps this object alive until it returns, longer than the metrics may live
}

std::chrono::milliseconds SpoolQueue::age_of(const Record& record, config::Clock::Instant now) const {
  if (!ledger_.is_old(record.sequence)) return accept_times_.age(record.sequence, record.accepted_ms, now);
  return std::chrono::milliseconds(std::max<std::int64_t>(clock_.wall_ms() - record.accepted_ms, 0));
}

std::size_t SpoolQueue::pending() const {
  const config::MutexLock lock(mutex_);
  return ledger_.pending();
}

std::optional<config::Clock::Instant> SpoolQueue::oldest() const {
  const config::MutexLock lock(mutex_);
  return ledger_.oldest();
}

SpoolQueue::Stored SpoolQueue::store(const Message& message, std::int64_t accepted_ms, Position& where) {
  bool dropped = false;
  for (;;) {
    const SpoolStore::Append appended = store_.append(accepted_ms, message, where);
    switch (appended) {
      case SpoolStore::Append::stored:
        if (std::exchange(disk_failing_, false)) logger.info("{}: the disk takes messages again", spool_.folder);
        dropping_helps_ = true;
        return Stored::yes;
      case SpoolStore::Append::too_large:
        return Stored::never;
      case SpoolStore::Append::disk_full:
      case SpoolStore::Append::failed:
        if (!std::exchange(disk_failing_, true)) {
          logger.error("{}; no message is accepted until the disk can be written again", store_.problem());
        }
        meters_.disk_failed();
        if (dropped) dropping_helps_ = false;  // other programs take the room that this one gives up
        if (appended == SpoolStore::Append::failed || !dropping_helps_ || spool_.when_full == SpoolFull::block ||
            store_.bytes() == 0) {
          return Stored::no_room;
        }
        break;
      case SpoolStore::Append::full:
        if (spool_.when_full == SpoolFull::block) return Stored::no_room;
        break;
    }
    dropped = true;
    const std::uint64_t kept = store_.drop_oldest();
    const config::MutexLock lock(mutex_);
    count(ledger_.drop_below(kept, reason::spool_full), reason::spool_full);
  }
}

Published SpoolQueue::publish(Message message) {
  const char* why_not = refusal(message);
  const config::MutexLock order(order_);
  bool stuck = false;
  {
    const config::MutexLock lock(mutex_);
    if (closed_) return {PublishStatus::closed};
    stuck = sync_stuck();
  }
  Position where;
  const auto accepted = now();
  const std::int64_t accepted_ms = clock_.wall_ms();
  const Stored stored = why_not != nullptr ? Stored::never
                        : stuck            ? Stored::no_room
                                           : store(message, accepted_ms, where);
  const config::MutexLock lock(mutex_);
  if (stored == Stored::never) {
    ledger_.settled_unstored(Outcome::refused, why_not != nullptr ? why_not : "larger_than_the_spool");
    wake();
    return {PublishStatus::accepted, ledger_.last_number()};
  }
  if (stored == Stored::no_room) {
    wake();
    if (spool_.when_full == SpoolFull::block) {
      wanted_room_ = stuck ? 0 : store_.last_size();
      if (disk_failing_ || stuck) retry_at_ = now() + disk_retry;
      return {PublishStatus::would_block};
    }
    ledger_.settled_unstored(Outcome::dropped, reason::spool_failed);
    count(1, reason::spool_failed);
    return {PublishStatus::accepted, ledger_.last_number()};
  }
  const bool next = !sending_ && ledger_.all_sent();
  accept_times_.note(ledger_.next(), accepted, accepted_ms);
  ledger_.note_stored();
  const Published published{PublishStatus::accepted, ledger_.last_number()};
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
  sync_soon();
  if (ledger_.has_events()) wake();
  if (next) {
    wait_from_ = where;
    if (may_send()) {
      {
        const Sending sending(*this);
        sender_.assert_held();
        if (send(std::move(message), {}, accepted)) wait_from_.reset();
      }
      if (!ledger_.all_sent() && may_send()) wake();
    }
  }
  return published;
}

void SpoolQueue::sync_soon() {
  if (spool_.sync == SpoolSync::never || std::exchange(dirty_, true)) return;
  sync_at_ = spool_.sync == SpoolSync::always ? now() : now() + spool_.interval;
  wake();
}

bool SpoolQueue::may_send() const {
  return !closed_ && !inner_full_ && ledger_.under_way() < options_.capacity &&
         (ledger_.under_way() == 0 || ledger_.under_way_bytes() < most_bytes_under_way);
}

bool SpoolQueue::send(Message message, const Past& past, config::Clock::Instant accepted) {
  ledger_.note_sent(message.payload.size(), accepted);
  inner_full_ = true;  // set before the call, because on_writable may come before the call returns
  PublishStatus status = PublishStatus::closed;
  {
    const config::Unlocked unlocked(mutex_);
    status = inner_->publish_again(std::move(message), past).status;
  }
  if (status == PublishStatus::accepted) {
    inner_full_ = false;
    return true;
  }
  if (ledger_.note_not_taken(reason::spool_full)) count(1, reason::spool_full);
  return false;
}

std::optional<Record> SpoolQueue::next_waiting() {
  while (!ledger_.all_sent()) {
    if (const auto from = std::exchange(wait_from_, std::nullopt)) {
      held_.reset();
      reader_.seek(*from);
    }
    const std::uint64_t end = ledger_.next();
    std::optional<Record> record;
    std::uint64_t damaged_bytes = 0;
    {
      const config::Unlocked unlocked(mutex_);
      record = held_ ? std::exchange(held_, std::nullopt) : reader_.next();
      damaged_bytes = reader_.take_damaged_bytes();
    }
    meters_.damaged_bytes(damaged_bytes);
    const std::uint64_t lost = ledger_.drop_below(record ? record->sequence : end, reason::spool_damaged);
    if (lost > 0) {
      logger.error("{}: {} message(s) cannot be read any more and are lost", spool_.folder, lost);
      count(lost, reason::spool_damaged);
    }
    if (!record || record->sequence < ledger_.unsent()) continue;
    if (options_.deadline.count() > 0 && age_of(*record, now()) >= options_.deadline) {
      count(ledger_.drop_below(record->sequence + 1, reason::deadline), reason::deadline);
      continue;
    }
    return record;
  }
  return std::nullopt;
}

void SpoolQueue::send_waiting() {
  if (sending_) return;  // publish() does; it wakes this thread when messages are left
  const Sending sending(*this);
  sender_.assert_held();
  for (int i = 0; i < records_per_turn && may_send(); ++i) {
    std::optional<Record> record = next_waiting();
    if (!record) break;
    Past past;
    past.possibly_sent = ledger_.is_old(record->sequence);
    const Time at = now();
    past.age = age_of(*record, at);
    if (ledger_.unsent() != record->sequence) continue;
    Message message = record->message;
    if (!send(std::move(message), past, at - past.age)) held_ = std::move(record);
  }
}

void SpoolQueue::on_inner_outcome(std::uint64_t number, Outcome outcome, const std::string& reason) {
  const config::MutexLock lock(mutex_);
  ledger_.note_answered(number, outcome, reason);
  if (++unwritten_marks_ >= outcomes_per_mark || ledger_.under_way() == 0) {
    unwritten_marks_ = 0;
    const std::uint64_t mark = ledger_.mark();
    {
      const config::Unlocked unlocked(mutex_);  // so that publish() does not wait for a slow write of the mark's file
      store_.raise_mark(mark);
    }
    if (wanted_room_ || store_.releasable()) wake();
  }
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
  if (!ledger_.all_sent() && ledger_.under_way() <= options_.capacity / 2) wake();
  note_stored();
  report();
}

void SpoolQueue::on_inner_writable() {
  const config::MutexLock lock(mutex_);
  inner_full_ = false;
  wake();
}

void SpoolQueue::count(std::uint64_t dropped, const char* reason) {
  if (dropped > 0) meters_.dropped(reason, dropped);
}

void SpoolQueue::note_stored() {
  if (!spool_.on_stored || spool_.sync == SpoolSync::never) return;
  // Finished messages need no sync. After a failed sync, a later one that succeeds does not prove that the data of the
  // failed one is on the disk: so nothing counts as synced until the mark has passed it.
  const std::uint64_t mark = ledger_.mark();
  const std::uint64_t safe = mark < doubtful_ ? mark : std::max(mark, synced_);
  stored_number_ = std::max(stored_number_, ledger_.number_before(safe));
}

void SpoolQueue::report() {
  if (reporting_) return;  // the thread that reports checks again before it ends
  reporting_ = std::this_thread::get_id();
  while (ledger_.has_events() || writable_due_ || stored_told_ != stored_number_) {
    const std::vector<Ledger::Event> events = ledger_.take_events();
    const bool writable = std::exchange(writable_due_, false);
    const std::uint64_t stored = std::exchange(stored_told_, stored_number_) == stored_number_ ? 0 : stored_number_;
    {
      const config::Unlocked unlocked(mutex_);
      tell(events, stored, writable);
    }
    ledger_.reported(events);
    changed_.notify_all();
  }
  reporting_.reset();
  changed_.notify_all();
}

/// Calls the user's callbacks. \param stored argument of on_stored; 0: it is not called.
void SpoolQueue::tell(const std::vector<Ledger::Event>& events, std::uint64_t stored, bool writable) try {
  for (const Ledger::Event& event : events) {
    for (std::uint64_t i = 0; options_.on_outcome && i < event.count; ++i) {
      options_.on_outcome(event.first_number == 0 ? 0 : event.first_number + i, event.outcome, event.reason);
    }
  }
  if (stored > 0) spool_.on_stored(stored);
  if (writable && options_.on_writable) options_.on_writable();
} catch (const std::exception& error) {
  logger.error("a callback of the publisher of topic {} threw: {}", topic_.name, error.what());
} catch (...) {
  logger.error("a callback of the publisher of topic {} threw", topic_.name);
}

bool SpoolQueue::drain(std::chrono::milliseconds limit) {
  const config::MutexLock lock(mutex_);
  return changed_.wait_until(mutex_, clock_, now() + limit,
                             [this]() IOTCLOUD_REQUIRES(mutex_) { return ledger_.pending() == 0; });
}

void SpoolQueue::tidy() {
  const bool sync = dirty_ && sync_at_ <= now();
  if (sync) dirty_ = false;
  const std::uint64_t end = ledger_.next();
  const std::optional<std::uint64_t> mark =
      std::exchange(unwritten_marks_, 0) > 0 ? std::optional(ledger_.mark()) : std::nullopt;
  int error = 0;
  {
    const config::Unlocked unlocked(mutex_);
    if (mark) store_.raise_mark(*mark);
    if (sync) error = store_.sync();
    store_.release();
  }
  accept_times_.forget_below(ledger_.mark());
  meters_.level(ledger_.next() - ledger_.mark(), store_.bytes());
  if (!sync) return;
  if (error == 0) {
    if (std::exchange(sync_failing_, false)) {
      logger.info("{}: syncing to the disk works again", spool_.folder);
      if (retry_at_) retry_at_ = now();
    }
    synced_ = end;
    note_stored();
    return;
  }
  meters_.disk_failed();
  if (!std::exchange(sync_failing_, true)) {
    logger.error("{} cannot be synced to the disk: {}{}", spool_.folder, std::strerror(error),
                 spool_.sync == SpoolSync::always ? "; no message is accepted until it can" : "");
  }
  doubtful_ = end;
  dirty_ = true;
  sync_at_ = now() + disk_retry;
}

std::optional<ServedSpool::Time> SpoolQueue::next_time() const {
  if (!ledger_.all_sent() && may_send()) return now();
  std::optional<Time> next = retry_at_;
  if (dirty_ && (!next || sync_at_ < *next)) next = sync_at_;
  return next;
}

std::optional<ServedSpool::Time> SpoolQueue::serve() noexcept {
  try {
    const auto self = shared_from_this();  // a callback may close the publisher, which lets go of this object
    const config::MutexLock lock(mutex_);
    if (closed_) return std::nullopt;
    send_waiting();
    tidy();
    if (retry_at_ && *retry_at_ <= now()) {
      retry_at_.reset();
      writable_due_ = std::exchange(wanted_room_, std::nullopt).has_value();
    } else if (!retry_at_ && wanted_room_ && store_.has_room(*wanted_room_)) {
      wanted_room_.reset();
      writable_due_ = true;
    }
    report();
    return closed_ ? std::nullopt : next_time();
  } catch (const std::exception& error) {  // memory ran out
    logger.error("{}: {}", spool_.folder, error.what());
    return now() + disk_retry;
  }
}

}  // namespace iotcloud::brokers::spool
