#include "iotcloud/brokers/client/outbox.h"

#include <algorithm>
#include <random>
#include <utility>

#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::client {
namespace {

constexpr std::chrono::milliseconds first_retry{20};
constexpr std::chrono::milliseconds last_retry{1000};
// A message that no queue takes goes to the server and back with each try. So it is tried often for about three
// seconds, so that a reader that starts together with the publisher waits little, and rarely after that.
constexpr unsigned eager_tries = 20;
constexpr std::chrono::milliseconds last_eager_retry{200};
// A refusal can make the server close the channel that all publishers of the connection share, so refused messages are
// tried again more rarely.
constexpr std::chrono::milliseconds first_after_refusal{50};
constexpr std::chrono::milliseconds last_after_refusal{5000};

PublisherOptions with_some_capacity(PublisherOptions options) {
  options.capacity = std::max<std::size_t>(options.capacity, 1);
  return options;
}

std::uint64_t new_id() {
  std::random_device random;
  return std::uniform_int_distribution<std::uint64_t>()(random);
}

}  // namespace

Outbox::Outbox(Topic to, PublisherOptions how)
    : topic(std::move(to)),
      options(with_some_capacity(std::move(how))),
      id(new_id()),
      eager_(first_retry, last_eager_retry),
      patient_(last_retry, last_retry),
      backoff_(first_retry, last_retry),
      refusals_(first_after_refusal, last_after_refusal) {}

bool Outbox::has_room() const {
  return options.when_full == WhenFull::keep_newest || waiting_.size() + under_way_ < options.capacity;
}

AcceptedMessage Outbox::accept(Message message, Instant now, const Past& past) {
  ++pending_;
  return {std::move(message), ++last_number_, now - past.age, false, past.possibly_sent};
}

void Outbox::add_waiting(AcceptedMessage accepted) {
  insert(std::move(accepted));
  trim();
}

bool Outbox::may_send() const {
  return ready && !closed && !retry_at_ && under_way_ < options.capacity && (proven_ || under_way_ == 0);
}

AcceptedMessage Outbox::take_next() {
  AcceptedMessage next = std::move(waiting_.front());
  waiting_.pop_front();
  ++under_way_;
  return next;
}

void Outbox::insert(AcceptedMessage accepted) {
  const auto place =
      std::upper_bound(waiting_.begin(), waiting_.end(), accepted.number,
                       [](std::uint64_t number, const AcceptedMessage& other) { return number < other.number; });
  waiting_.insert(place, std::move(accepted));
}

void Outbox::trim() {
  if (options.when_full != WhenFull::keep_newest) return;
  while (waiting_.size() > options.capacity) {
    settle(waiting_.front().number, Outcome::dropped, unread_ ? reason::no_reader : reason::superseded);
    waiting_.pop_front();
  }
}

void Outbox::settle(std::uint64_t number, Outcome outcome, std::string reason) {
  events_.push_back({number, outcome, std::move(reason)});
  if (wants_writable_ && has_room()) {
    wants_writable_ = false;
    writable_due_ = true;
  }
}

void Outbox::confirmed(std::uint64_t number) {
  --under_way_;
  proven_ = true;
  unread_ = false;
  put_off_in_row_ = 0;
  retry_at_.reset();
  complaint_.clear();
  forget_tries();
  settle(number, Outcome::confirmed, "");
}

void Outbox::refused(std::uint64_t number, const std::string& reason) {
  --under_way_;
  settle(number, Outcome::refused, reason);
}

void Outbox::returned(AcceptedMessage accepted, Instant now) {
  --under_way_;
  if (!retry_at_) retry_at_ = now + (++unread_tries_ <= eager_tries ? eager_ : patient_).next();
  proven_ = false;
  unread_ = true;
  insert(std::move(accepted));
  trim();
}

void Outbox::put_off(AcceptedMessage accepted, Instant now) {
  --under_way_;
  if (!retry_at_) retry_at_ = now + backoff_.next();
  proven_ = false;
  ++put_off_in_row_;
  accepted.resent = true;
  insert(std::move(accepted));
  trim();
}

bool Outbox::refused_for_now(AcceptedMessage accepted, const std::string& why, Instant now) {
  --under_way_;
  if (!retry_at_) retry_at_ = now + refusals_.next();
  proven_ = false;
  insert(std::move(accepted));
  trim();
  return std::exchange(complaint_, why) != why;
}

void Outbox::lost(AcceptedMessage accepted) {
  --under_way_;
  accepted.resent = true;
  insert(std::move(accepted));
  trim();
}

void Outbox::disconnected() {
  put_off_in_row_ = 0;
  ready = false;
  proven_ = false;
  unread_ = false;
  retry_at_.reset();
  forget_tries();
}

void Outbox::interrupted() {
  ready = false;
  proven_ = false;
}

void Outbox::forget_tries() {
  unread_tries_ = 0;
  refusals_.reset();
  eager_.reset();
  backoff_.reset();
}

void Outbox::expire(Instant now) {
  const bool has_deadline = options.deadline.count() > 0;
  if (waiting_.empty() || (!has_deadline && !options.void_before)) return;
  const Instant void_before = options.void_before ? options.void_before() : Instant::min();
  const std::size_t before = waiting_.size();
  if (has_deadline || waiting_.front().accepted_at < void_before) {
    std::erase_if(waiting_, [&](const AcceptedMessage& accepted) {
      const bool fenced = accepted.accepted_at < void_before;
      const bool old = fenced || (has_deadline && accepted.accepted_at + options.deadline <= now);
      if (old) {
        events_.push_back({accepted.number, Outcome::dropped, fenced ? reason::fenced : reason::deadline});
      }
      return old;
    });
  }
  if (waiting_.size() < before && std::exchange(wants_writable_, false)) writable_due_ = true;
}

std::optional<Instant> Outbox::next_timer() const {
  if (waiting_.empty()) return std::nullopt;
  std::optional<Instant> next = retry_at_;
  if (options.deadline.count() > 0) {
    const Instant expires = waiting_.front().accepted_at + options.deadline;
    if (!next || expires < *next) next = expires;
  }
  return next;
}

void Outbox::fire_timer(Instant now) {
  expire(now);
  if (retry_at_ && *retry_at_ <= now) retry_at_.reset();
}

void Outbox::close(const std::vector<std::uint64_t>& under_way_numbers) {
  closed = true;
  wants_writable_ = writable_due_ = false;
  for (const std::uint64_t number : under_way_numbers) settle(number, Outcome::unknown, reason::closed);
  for (const AcceptedMessage& accepted : waiting_) settle(accepted.number, Outcome::unknown, reason::closed);
  waiting_.clear();
}

std::vector<Outbox::Event> Outbox::take_events(bool& writable) {
  writable = std::exchange(writable_due_, false);
  return std::exchange(events_, {});
}

}  // namespace iotcloud::brokers::client
