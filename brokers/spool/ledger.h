#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::spool {

/// The bookkeeping of one spooled publisher: which of its records were handed to the inner publisher, which are done
/// with, and which outcomes are still to be reported. Records have sequence numbers (the spool's), accepted messages
/// publish numbers (this publisher's), what is under way the inner publisher's numbers. Guarded by its owner's mutex.
class Ledger {
 public:
  /// One or more messages in a row with the same outcome.
  struct Event {
    std::uint64_t first_number = 0;  ///< 0: accepted by an earlier process; all of the event then
    std::uint64_t count = 0;
    Outcome outcome = Outcome::confirmed;
    std::string reason;
  };

  /// \param mark first record that is not done with \param next what the next record gets; those before it are an
  /// earlier process's
  Ledger(std::uint64_t mark, std::uint64_t next) : unsent_(mark), next_(next), own_(next) { pending_ = next - mark; }

  /// A message was stored as the next record.
  void stored();
  /// A message was accepted and has its outcome already.
  void settled_unstored(Outcome outcome, const std::string& reason);

  std::uint64_t next() const { return next_; }
  /// The next record to hand to the inner publisher; next() when all were.
  std::uint64_t unsent() const { return unsent_; }
  bool all_sent() const { return unsent_ == next_; }
  bool is_old(std::uint64_t sequence) const { return sequence < own_; }
  /// The record unsent() is handed over; the inner publisher gives it the next of its numbers.
  void send(std::size_t bytes);
  /// It did not take it after all. When newer ones were dropped meanwhile it is dropped too. \return whether
  bool unsend(const char* reason);
  /// The inner publisher's outcome.
  void answered(std::uint64_t inner_number, Outcome outcome, const std::string& reason);
  /// Gives up what is unsent below `sequence`. \return how many
  std::uint64_t drop_below(std::uint64_t sequence, const char* reason);
  /// Every message of this publisher without an outcome becomes `unknown`.
  void close(const char* reason);

  /// Every record below is done with.
  std::uint64_t mark() const { return under_way_.empty() ? unsent_ : under_way_.front().sequence; }
  std::size_t under_way() const { return under_way_.size(); }
  std::size_t under_way_bytes() const { return under_way_bytes_; }
  /// Messages that have no outcome, or one that has not been reported.
  std::size_t pending() const { return pending_; }

  bool has_events() const { return !events_.empty(); }
  std::vector<Event> take_events() { return std::exchange(events_, {}); }
  void reported(const std::vector<Event>& events);

 private:
  struct UnderWay {
    std::uint64_t sequence = 0;
    std::size_t bytes = 0;
    bool done = false;
  };
  /// From this record on, a publish number is the sequence number and this much.
  struct Shift {
    std::uint64_t from = 0;
    std::uint64_t less = 0;  ///< number = sequence - less (modulo 2^64)
  };

  void settle(std::uint64_t first, std::uint64_t end, Outcome outcome, const std::string& reason);
  void add_event(std::uint64_t number, std::uint64_t count, Outcome outcome, const std::string& reason);

  std::uint64_t unsent_;
  std::uint64_t next_;
  const std::uint64_t own_;         ///< records from here on are this publisher's
  std::uint64_t last_number_ = 0;   ///< publish number
  std::deque<Shift> shifts_;        ///< ascending; those that no record needs any more are gone
  std::deque<UnderWay> under_way_;  ///< ascending
  std::uint64_t first_inner_ = 1;   ///< the inner publisher's number of under_way_.front()
  std::size_t under_way_bytes_ = 0;
  std::size_t pending_ = 0;
  std::vector<Event> events_;
};

}  // namespace iotcloud::brokers::spool
