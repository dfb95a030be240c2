#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {

using Instant = config::Clock::Instant;

/// An accepted message on its way out.
struct Outgoing {
  Message message;
  std::uint64_t number = 0;  ///< of its publisher
  Instant accepted;
  bool resent = false;  ///< was sent on a connection that was lost before the answer
  bool old = false;     ///< an earlier process may have sent it
};

/// One publisher's messages: what waits, what is under way, and which outcomes are still to be reported.
/// Pure bookkeeping; guarded by the mutex of the link that owns it.
///
/// A topic is *proven* once a message came through: until then, and again when one came back because nobody reads the
/// topic, one message at a time is sent, so that those behind it cannot overtake it when a reader appears.
class Outbox {
 public:
  Outbox(Topic topic, PublisherOptions options);

  struct Event {
    std::uint64_t number = 0;
    Outcome outcome = Outcome::confirmed;
    std::string reason;
  };

  const Topic topic;
  const PublisherOptions options;
  const std::uint64_t id;  ///< by chance, so that it tells this publisher from all others anywhere

  /// Numbers the message. Null: would_block. Otherwise it is the caller's to send or to add_waiting().
  bool has_room() const;
  Outgoing accept(Message message, Instant now, const Past& past = {});
  void refuse_room() { wants_writable_ = true; }
  /// Adds to what waits; keep_newest may drop the oldest.
  void add_waiting(Outgoing outgoing);

  /// Whether the next message may be sent now, as far as this publisher is concerned.
  bool may_send() const;
  bool idle() const { return waiting_.empty(); }
  /// Takes what is next, noting that it is under way; the caller has asked may_send().
  Outgoing take_next();
  const Outgoing& next() const { return waiting_.front(); }
  void sent_directly() { ++under_way_; }

  void confirmed(std::uint64_t number);
  void refused(std::uint64_t number, const std::string& reason);
  /// Came back unread: it waits again and is tried after a while. Whether an earlier sending of it was read is as
  /// unknown as before.
  void returned(Outgoing outgoing, Instant now);
  /// The server could not store it now (a queue without its leader, one that is full): tried again after a while,
  /// marked as sent before, because another queue may have it.
  void put_off(Outgoing outgoing, Instant now);
  /// So often in a row.
  std::size_t put_off_in_row() const { return put_off_in_row_; }
  /// The connection was lost before the answer.
  void lost(Outgoing outgoing);
  /// A new connection: everything has to be proven again.
  void disconnected();
  /// Drops what is too old, and what its sender may not send any more.
  void expire(Instant now);
  /// When something is to be done without anyone asking (a message to try again, or one that expires).
  std::optional<Instant> next_timer() const;
  /// Lets a message be tried again when its time has come.
  void fire_timer(Instant now);
  /// Everything without an outcome becomes `unknown`. `under_way_numbers`: those that the link knows.
  void close(const std::vector<std::uint64_t>& under_way_numbers);

  bool closed = false;
  bool ready = false;        ///< its exchange was declared on this connection
  bool in_runnable = false;  ///< stands in the link's list of those with something to send
  bool in_report = false;    ///< stands in the link's list of those with something to report
  bool reporting = false;    ///< a thread is calling its callbacks

  std::size_t pending() const { return pending_; }
  bool has_report() const { return !events_.empty() || writable_due_; }
  /// Hands the outcomes over to be reported; follow with reported(number of events).
  std::vector<Event> take_events(bool& writable);
  void reported(std::size_t count) { pending_ -= count; }

 private:
  void settle(std::uint64_t number, Outcome outcome, std::string reason);
  void insert(Outgoing outgoing);
  void trim();
  void forget_tries();

  std::deque<Outgoing> waiting_;  ///< ascending numbers
  std::vector<Event> events_;
  std::uint64_t last_number_ = 0;
  std::size_t pending_ = 0;    ///< accepted, outcome not reported yet
  std::size_t under_way_ = 0;  ///< sent, no answer yet
  std::size_t put_off_in_row_ = 0;
  bool proven_ = false;
  bool unread_ = false;  ///< the last answer was: nobody reads it
  std::optional<Instant> retry_at_;
  unsigned unread_tries_ = 0;  ///< so often in a row nobody read it
  Backoff eager_, patient_;    ///< for what nobody reads: at first, and later
  Backoff backoff_;            ///< for what the server could not store
  bool wants_writable_ = false;
  bool writable_due_ = false;
};

}  // namespace iotcloud::brokers::client
