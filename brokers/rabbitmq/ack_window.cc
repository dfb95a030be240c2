#include "iotcloud/brokers/rabbitmq/ack_window.h"

namespace iotcloud::brokers::rabbitmq {

bool AckWindow::delivered(std::uint64_t tag) {
  if (tag != first_tag_ + states_.size()) return false;
  states_.push_back(State::unsettled);
  return true;
}

bool AckWindow::settle(std::uint64_t tag, Settlement settlement) {
  if (tag < first_tag_ || tag >= first_tag_ + states_.size()) return false;
  State& state = states_[tag - first_tag_];
  if (state != State::unsettled) return false;
  state = settlement == Settlement::accept  ? State::accept
          : settlement == Settlement::retry ? State::retry
                                            : State::reject;
  ++settled_;
  return true;
}

std::vector<AckWindow::Action> AckWindow::take(std::size_t patience) {
  std::vector<Action> actions;
  const auto kind_of = [](State state) {
    return state == State::accept ? Kind::acknowledge : state == State::retry ? Kind::requeue : Kind::reject;
  };
  // The settled ones in front: runs of one kind, each with one `multiple`.
  while (!states_.empty() && states_.front() != State::unsettled) {
    if (states_.front() != State::told) {
      const Kind kind = kind_of(states_.front());
      if (!actions.empty() && actions.back().kind == kind) {
        actions.back().tag = first_tag_;
      } else {
        actions.push_back({kind, first_tag_, true});
      }
      --settled_;
    }
    states_.pop_front();
    ++first_tag_;
  }
  // Behind an unsettled one: each for itself.
  if (settled_ == 0) return actions;
  const bool all = settled_ > patience;
  for (std::size_t i = 0; i < states_.size(); ++i) {
    State& state = states_[i];
    if (state == State::unsettled || state == State::told || (state == State::accept && !all)) continue;
    actions.push_back({kind_of(state), first_tag_ + i, false});
    state = State::told;
    --settled_;
  }
  return actions;
}

void AckWindow::clear() {
  states_.clear();
  first_tag_ = 1;
  settled_ = 0;
}

}  // namespace iotcloud::brokers::rabbitmq
