#include "iotcloud/brokers/client/ack_window.h"

#include <algorithm>
#include <utility>

namespace iotcloud::brokers::client {

bool AckWindow::delivered(Arrived arrived) {
  if (arrived.tag != first_tag_ + entries_.size()) return false;
  waiting_.push_back(arrived.tag);
  entries_.push_back({State::waits, arrived.redelivered, 0, std::move(arrived.message)});
  return true;
}

void AckWindow::skipped() {
  entries_.push_back({State::accept, false, 0, {}});
  ++settled_;
}

Arrived AckWindow::next() {
  const std::uint64_t tag = waiting_.front();
  waiting_.pop_front();
  Entry& entry = entries_[tag - first_tag_];
  entry.state = State::handed_on;
  ++handed_on_;
  newest_handed_on_ = std::max(newest_handed_on_, tag);
  return {entry.message, entry.redelivered, tag, ++entry.tries};
}

bool AckWindow::settle(std::uint64_t tag, Settlement settlement) {
  if (tag < first_tag_ || tag >= first_tag_ + entries_.size()) return false;
  Entry& entry = entries_[tag - first_tag_];
  if (entry.state != State::handed_on) return false;
  --handed_on_;
  if (settlement == Settlement::retry) {
    entry.state = State::waits;
    entry.redelivered = true;
    waiting_.insert(std::lower_bound(waiting_.begin(), waiting_.end(), tag), tag);
    return true;
  }
  entry.state = settlement == Settlement::accept ? State::accept : State::reject;
  entry.message = {};
  ++settled_;
  return true;
}

std::vector<AckWindow::Action> AckWindow::take(std::size_t patience) {
  std::vector<Action> actions;
  const auto kind_of = [](State state) { return state == State::accept ? Kind::acknowledge : Kind::reject; };
  // Settled deliveries at the front: one action with `multiple` for each run of the same kind.
  while (!entries_.empty() && !unsettled(entries_.front())) {
    if (entries_.front().state != State::told) {
      const Kind kind = kind_of(entries_.front().state);
      if (!actions.empty() && actions.back().kind == kind) {
        actions.back().tag = first_tag_;
      } else {
        actions.push_back({kind, first_tag_, true});
      }
      --settled_;
    }
    entries_.pop_front();
    ++first_tag_;
  }
  // Settled deliveries behind an unsettled one: one acknowledgement each.
  if (settled_ == 0) return actions;
  const bool all = settled_ > patience;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    State& state = entries_[i].state;
    if (unsettled(entries_[i]) || state == State::told || (state == State::accept && !all)) continue;
    actions.push_back({kind_of(state), first_tag_ + i, false});
    state = State::told;
    --settled_;
  }
  return actions;
}

std::uint64_t AckWindow::advance() {
  while (!entries_.empty() && !unsettled(entries_.front())) {
    if (entries_.front().state != State::told) --settled_;
    entries_.pop_front();
    ++first_tag_;
  }
  return first_tag_;
}

bool AckWindow::is_settled(std::uint64_t tag) const {
  return tag < first_tag_ || (tag < first_tag_ + entries_.size() && !unsettled(entries_[tag - first_tag_]));
}

void AckWindow::return_all() {
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    if (entries_[i].state == State::handed_on) settle(first_tag_ + i, Settlement::retry);
  }
}

void AckWindow::clear() {
  entries_.clear();
  waiting_.clear();
  first_tag_ = 1;
  settled_ = handed_on_ = 0;
  newest_handed_on_ = 0;
}

}  // namespace iotcloud::brokers::client
