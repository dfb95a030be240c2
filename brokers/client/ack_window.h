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
  std::uint32_t tries = 0;  ///< how often it was handed on, this time included
};

/// What one consumer has from the server: keeps each message until it is settled, and turns settlements into
/// as few acknowledgements as possible (`multiple` up to the first delivery that is unsettled). A retry stays here: the
/// server is told nothing and the kept message is handed on again. Not thread safe.
class AckWindow {
 public:
  enum class Kind { acknowledge, reject };
  struct Action {
    Kind kind = Kind::acknowledge;
    std::uint64_t tag = 0;
    bool multiple = false;  ///< all unsettled ones up to the tag
    friend bool operator==(const Action&, const Action&) = default;
  };

  /// Notes a delivery; the server counts tags up from 1 on each channel. \return false when the tag is not the next
  /// one.
  bool delivered(Arrived arrived);
  /// Notes a delivery, the next one, that needs no handling: it counts as accepted.
  void skipped();
  /// The oldest message that waits to be handed on, marked as redelivered when it was before. `waiting() > 0`.
  Arrived next();
  std::size_t waiting() const { return waiting_.size(); }
  /// `retry` makes it wait again, before all that came after it.
  /// \return false for what is not under way (settled before, or of an earlier channel).
  bool settle(std::uint64_t tag, Settlement settlement);
  /// What to send now. Settled deliveries behind an unsettled one wait for it, accepted ones until there are more than
  /// `patience` of them (so that one slow delivery does not eat up the whole prefetch); 0 = send everything.
  std::vector<Action> take(std::size_t patience);
  /// Deliveries that somebody has and has not settled.
  std::size_t handed_on() const { return handed_on_; }
  /// For servers that are told how far a reader has come, instead of take(): forgets the settled deliveries in front.
  /// \return the tag of the first that is unsettled, or is still to come
  std::uint64_t advance();
  bool is_settled(std::uint64_t tag) const;
  /// Makes all that is handed on and unsettled wait again: nobody can settle it any more.
  void return_all();
  /// Deliveries that are settled and not told to the server yet.
  std::size_t settled() const { return settled_; }
  /// All deliveries that are kept, settled ones behind an unsettled one included.
  std::size_t size() const { return entries_.size(); }
  /// Forgets everything: the channel is gone.
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
};

}  // namespace iotcloud::brokers::client
