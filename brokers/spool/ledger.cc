#include "iotcloud/brokers/spool/ledger.h"

#include <algorithm>

namespace iotcloud::brokers::spool {

void Ledger::note_stored() {
  const std::uint64_t less = next_ - ++last_number_;
  if (shifts_.empty() || shifts_.back().less != less) shifts_.push_back({next_, less});
  ++next_;
  ++pending_;
}

void Ledger::settled_unstored(Outcome outcome, const std::string& reason) {
  ++pending_;
  add_event(++last_number_, 1, outcome, reason);
}

std::uint64_t Ledger::number_before(std::uint64_t sequence) const {
  if (sequence >= next_) return last_number_;
  const auto shift = std::find_if(shifts_.rbegin(), shifts_.rend(),
                                  [&](const Shift& candidate) { return candidate.from <= sequence; });
  return shift == shifts_.rend() ? 0 : sequence - shift->less - 1;
}

void Ledger::note_sent(std::size_t bytes, config::Clock::Instant accepted) {
  under_way_.push_back({unsent_++, bytes, accepted, false});
  under_way_bytes_ += bytes;
}

bool Ledger::note_not_taken(const char* reason) {
  const UnderWay entry = under_way_.back();
  under_way_bytes_ -= entry.bytes;
  under_way_.pop_back();
  const bool dropped = unsent_ != entry.sequence + 1;
  if (dropped) {
    settle(entry.sequence, entry.sequence + 1, Outcome::dropped, reason);
  } else {
    unsent_ = entry.sequence;
  }
  return dropped;
}

void Ledger::note_answered(std::uint64_t inner_number, Outcome outcome, const std::string& reason) {
  if (inner_number < first_inner_ || inner_number - first_inner_ >= under_way_.size()) return;
  UnderWay& entry = under_way_[inner_number - first_inner_];
  if (entry.done || outcome == Outcome::unknown) return;  // unknown: the message stays in the spool
  entry.done = true;
  under_way_bytes_ -= entry.bytes;
  settle(entry.sequence, entry.sequence + 1, outcome, reason);
  while (!under_way_.empty() && under_way_.front().done) {
    under_way_.pop_front();
    ++first_inner_;
  }
  while (shifts_.size() > 1 && shifts_[1].from <= mark()) shifts_.pop_front();
}

std::uint64_t Ledger::drop_below(std::uint64_t sequence, const char* reason) {
  const std::uint64_t end = std::min(sequence, next_);
  if (end <= unsent_) return 0;
  const std::uint64_t count = end - unsent_;
  settle(unsent_, end, Outcome::dropped, reason);
  unsent_ = end;
  return count;
}

void Ledger::close(const char* reason) {
  for (const UnderWay& entry : under_way_) {
    if (!entry.done && !is_old(entry.sequence)) settle(entry.sequence, entry.sequence + 1, Outcome::unknown, reason);
  }
  settle(std::max(unsent_, own_), next_, Outcome::unknown, reason);
}

void Ledger::settle(std::uint64_t first, std::uint64_t end, Outcome outcome, const std::string& reason) {
  if (first < own_ && first < end) {
    const std::uint64_t old_end = std::min(end, own_);
    add_event(0, old_end - first, outcome, reason);
    first = old_end;
  }
  for (auto shift = shifts_.begin(); shift != shifts_.end() && first < end; ++shift) {
    const std::uint64_t shift_end = std::next(shift) == shifts_.end() ? end : std::min(end, std::next(shift)->from);
    if (first >= shift_end) continue;
    add_event(first - shift->less, shift_end - first, outcome, reason);
    first = shift_end;
  }
}

void Ledger::add_event(std::uint64_t number, std::uint64_t count, Outcome outcome, const std::string& reason) {
  if (!events_.empty()) {
    Event& last = events_.back();
    const bool follows =
        number == 0 ? last.first_number == 0 : last.first_number != 0 && last.first_number + last.count == number;
    if (follows && last.outcome == outcome && last.reason == reason) {
      last.count += count;
      return;
    }
  }
  events_.push_back({number, count, outcome, reason});
}

void Ledger::reported(const std::vector<Event>& events) {
  for (const Event& event : events) pending_ -= event.count;
}

}  // namespace iotcloud::brokers::spool
