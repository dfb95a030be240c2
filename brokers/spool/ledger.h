#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::spool {

/// The bookkeeping of one spooled publisher: which records the inner publisher (that of the broker) has, which are
/// finished, and which outcomes must still be reported. A message has up to three numbers: as a record the spool's
/// sequence number, when it is accepted this publisher's publish number, and when it is under way the inner publisher's
/// number. Its owner's mutex guards it.
class Ledger {
 public:
  /// One or more consecutive messages with the same outcome.
  struct Event {
    std::uint64_t first_number = 0;  ///< 0: an earlier process accepted all messages of the event
    std::uint64_t count = 0;
    Outcome outcome = Outcome::confirmed;
    std::string reason;
  };

  /// \param mark sequence number of the first unfinished record. \param next sequence number that the next record gets;
  /// an earlier process wrote the records below it.
  Ledger(std::uint64_t mark, std::uint64_t next) : unsent_(mark), next_(next), own_(next) { pending_ = next - mark; }

  /// Notes that a message was accepted and stored as the next record.
  void note_stored();
  /// Notes that a message was accepted, is not stored, and has its outcome already.
  void settled_unstored(Outcome outcome, const std::string& reason);

  /// The publish number of the message that was accepted last.
  std::uint64_t last_number() const { return last_number_; }
  std::uint64_t next() const { return next_; }
  /// The first record that the inner publisher has not got; next() if it has all.
  std::uint64_t unsent() const { return unsent_; }
  bool all_sent() const { return unsent_ == next_; }
  /// Whether an earlier process wrote the record.
  bool is_old(std::uint64_t sequence) const { return sequence < own_; }
  /// The highest publish number of which this holds: its message and all before it are records below `sequence`, or
  /// were never stored. 0: there is none. \param sequence at least mark().
  std::uint64_t number_before(std::uint64_t sequence) const;
  /// Notes that the record unsent() is passed to the inner publisher, under that one's next number.
  /// \param accepted when its message was accepted
  void note_sent(std::size_t bytes, config::Clock::Instant accepted = {});
  /// Notes that the inner publisher did not take the record of the last note_sent(). If records behind it were dropped
  /// meanwhile, it is dropped too. \return whether it was dropped.
  bool note_not_taken(const char* reason);
  /// Notes the inner publisher's outcome.
  void note_answered(std::uint64_t inner_number, Outcome outcome, const std::string& reason);
  /// Gives up unsent records below `sequence`. \return their number.
  std::uint64_t drop_below(std::uint64_t sequence, const char* reason);
  /// Gives every message of this publisher without an outcome the outcome `unknown`.
  void close(const char* reason);

  /// All records below this are finished.
  std::uint64_t mark() const { return under_way_.empty() ? unsent_ : under_way_.front().sequence; }
  std::size_t under_way() const { return under_way_.size(); }
  /// When the oldest message that the inner publisher has was accepted; nullopt: it has none.
  std::optional<config::Clock::Instant> oldest() const {
    if (under_way_.empty()) return std::nullopt;
    return under_way_.front().accepted;
  }
  std::size_t under_way_bytes() const { return under_way_bytes_; }
  /// Number of messages without an outcome, or with one that was not reported.
  std::size_t pending() const { return pending_; }

  bool has_events() const { return !events_.empty(); }
  std::vector<Event> take_events() { return std::exchange(events_, {}); }
  /// Notes that these outcomes were reported.
  void reported(const std::vector<Event>& events);

 private:
  struct UnderWay {
    std::uint64_t sequence = 0;
    std::size_t bytes = 0;
    config::Clock::Instant accepted{};
    bool done = false;
  };
  /// From record `from` on, a publish number is the sequence number minus `less`.
  struct Shift {
    std::uint64_t from = 0;
    std::uint64_t less = 0;  ///< number = sequence - less (modulo 2^64)
  };

  void settle(std::uint64_t first, std::uint64_t end, Outcome outcome, const std::string& reason);
  void add_event(std::uint64_t number, std::uint64_t count, Outcome outcome, const std::string& reason);

  std::uint64_t unsent_;
  std::uint64_t next_;
  const std::uint64_t own_;         ///< records from here on are this publisher's
  std::uint64_t last_number_ = 0;   ///< publish number of the last accepted message
  std::deque<Shift> shifts_;        ///< ascending, without those that no record needs any more
  std::deque<UnderWay> under_way_;  ///< records that the inner publisher has, ascending; finished ones may remain
  std::uint64_t first_inner_ = 1;   ///< the inner publisher's number of under_way_.front()
  std::size_t under_way_bytes_ = 0;
  std::size_t pending_ = 0;
  std::vector<Event> events_;
};

}  // namespace iotcloud::brokers::spool
