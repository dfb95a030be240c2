#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// What one channel's consumer owes the server: collects settlements and turns them into as few acknowledgements as
/// possible (`multiple` up to the first delivery that is unsettled). Not thread safe.
class AckWindow {
 public:
  enum class Kind { acknowledge, requeue, reject };
  struct Action {
    Kind kind = Kind::acknowledge;
    std::uint64_t tag = 0;
    bool multiple = false;  ///< all unsettled ones up to the tag
    friend bool operator==(const Action&, const Action&) = default;
  };

  /// Notes a delivery; the server counts tags up from 1 on each channel. \return false when the tag is not the next
  /// one.
  bool delivered(std::uint64_t tag);
  /// \return false for what is not under way (settled before, or of an earlier channel).
  bool settle(std::uint64_t tag, Settlement settlement);
  /// What to send now. Settled deliveries behind an unsettled one wait for it, accepted ones until there are more than
  /// `patience` of them (so that one slow delivery does not eat up the whole prefetch); 0 = send everything.
  std::vector<Action> take(std::size_t patience);
  bool has_news() const { return settled_ > 0; }
  /// Deliveries that are settled and not told to the server yet.
  std::size_t settled() const { return settled_; }
  /// Deliveries from the first on that the server was not told about.
  std::size_t size() const { return states_.size(); }
  /// Forgets everything: the channel is gone.
  void clear();

 private:
  enum class State : std::uint8_t { unsettled, accept, retry, reject, told };
  std::deque<State> states_;  ///< of the deliveries from first_tag_ on
  std::uint64_t first_tag_ = 1;
  std::size_t settled_ = 0;
};

}  // namespace iotcloud::brokers::rabbitmq
