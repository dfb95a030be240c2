#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::client {

/// A received message.
struct Arrived {
  Message message;
  bool redelivered = false;
  std::uint64_t tag = 0;    ///< the channel's delivery tag
  std::uint32_t tries = 0;  ///< how often it was handed on, including this time
};

/// The messages that one consumer has received. Keeps each message until it is settled, and turns settlements into as
/// few acknowledgements as possible (`multiple` up to the first unsettled delivery). A retry sends the server nothing:
/// the window hands the kept message on again. Not thread safe.
class AckWindow {
 public:
  enum class Kind { acknowledge, reject };
  struct Action {
    Kind kind = Kind::acknowledge;
    std::uint64_t tag = 0;
    bool multiple = false;  ///< covers all unsettled deliveries up to the tag
    friend bool operator==(const Action&, const Action&) = default;
  };

  /// Adds a delivery. The server counts tags up from 1 on each channel. \return false when the tag is not the next one.
  bool delivered(Arrived arrived);
  /// Adds the next delivery as accepted, because it needs no handling.
  void skipped();
  /// Takes the oldest message that waits to be handed on, marked as redelivered if it was handed on before. Requires
  /// `waiting() > 0`.
  Arrived next();
  std::size_t waiting() const { return waiting_.size(); }
  /// Settles a delivery. `retry` makes it wait again, before all later ones.
  /// \return false when the delivery is not handed on (already settled, or of an earlier channel).
  bool settle(std::uint64_t tag, Settlement settlement);
  /// The acknowledgements to send now. Settled deliveries behind an unsettled one wait for it. Accepted ones wait only
  /// until there are more than `patience`, so that one slow delivery does not use up the whole prefetch; 0: send all.
  std::vector<Action> take(std::size_t patience);
  /// The highest tag that next() has returned; 0: none.
  std::uint64_t newest_handed_on() const { return newest_handed_on_; }
  /// Number of deliveries that were handed on and not settled.
  std::size_t handed_on() const { return handed_on_; }
  /// Removes the settled deliveries at the front. Replaces take() for servers that are told a reader's position.
  /// \return the tag of the first delivery that is unsettled or still to come.
  std::uint64_t advance();
  bool is_settled(std::uint64_t tag) const;
  /// Makes all handed-on, unsettled deliveries wait again, because no handler can settle them any more.
  void return_all();
  /// Number of settled deliveries that the server does not know about yet.
  std::size_t settled() const { return settled_; }
  /// Number of deliveries kept, including settled ones behind an unsettled one.
  std::size_t size() const { return entries_.size(); }
  /// Removes everything, because the channel is gone.
  void clear();

 private:
  enum class State : std::uint8_t { waits, handed_on, accept, reject, told };
  struct Entry {
    State state = State::waits;
    bool redelivered = false;
    std::uint32_t tries = 0;
    Message message;  ///< until it is settled
  };
  bool unsettled(const Entry& entry) const { return entry.state == State::waits || entry.state == State::handed_on; }

  std::deque<Entry> entries_;          ///< the deliveries from first_tag_ on
  std::deque<std::uint64_t> waiting_;  ///< tags, ascending
  std::uint64_t first_tag_ = 1;
  std::size_t settled_ = 0;
  std::size_t handed_on_ = 0;
  std::uint64_t newest_handed_on_ = 0;
};

}  // namespace iotcloud::brokers::client
