#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {

using Instant = config::Clock::Instant;

struct PublishLane;

/// A message that publish() has accepted and that has no outcome yet.
struct AcceptedMessage {
  Message message;
  std::uint64_t number = 0;  ///< of its publisher
  Instant accepted_at;
  bool resent = false;  ///< sent on a connection that was lost before the answer came
  bool old = false;     ///< an earlier process may have sent it
};

/// One publisher's messages: those that wait, the number under way (sent and unanswered), and the outcomes still to be
/// reported. Does no I/O. Guarded by the mutex of the PublishCore that owns it.
///
/// A topic is *proven* once a message was confirmed. Until then, and again after a message was returned because nobody
/// reads the topic, only one message at a time is sent, so that later ones cannot overtake it when a reader appears.
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
  const std::uint64_t id;  ///< random, so that it identifies this publisher among all publishers anywhere

  /// Whether accept() may be called now; if not, publish() answers `would_block`.
  bool has_room() const;
  AcceptedMessage accept(Message message, Instant now, const Past& past = {});
  void refuse_room() { wants_writable_ = true; }
  /// Adds a message to the waiting ones; with keep_newest this may drop the oldest.
  void add_waiting(AcceptedMessage accepted);

  /// Whether this publisher's state allows sending its next message now.
  bool may_send() const;
  bool idle() const { return waiting_.empty(); }
  /// Takes the next waiting message and counts it as under way. Requires may_send().
  AcceptedMessage take_next();
  const AcceptedMessage& next() const { return waiting_.front(); }
  void sent_directly() { ++under_way_; }

  void confirmed(std::uint64_t number);
  void refused(std::uint64_t number, const std::string& reason);
  /// The server returned the message because no queue takes it: it waits and is tried again after a pause. Its mark
  /// `resent` stays as it was.
  void returned(AcceptedMessage accepted, Instant now);
  /// The server could not store the message now (a queue has no leader or is full): it is tried again after a pause,
  /// marked as sent before, because another queue may have stored it.
  void put_off(AcceptedMessage accepted, Instant now);
  /// The server refused the message for a reason that may pass (a missing permission or exchange, a limit): it is tried
  /// again after a pause. \return whether this reason is new since the last confirmation
  bool refused_for_now(AcceptedMessage accepted, const std::string& why, Instant now);
  /// How often in a row the server could not store a message.
  std::size_t put_off_in_row() const { return put_off_in_row_; }
  /// The connection was lost before this message was answered: it waits again.
  void lost(AcceptedMessage accepted);
  /// The connection is lost: on the next one the topic must be proven again, without a pause.
  void disconnected();
  /// The server closed the channel because of some publisher's message: the topic must be proven again, but a pause
  /// before a retry goes on.
  void interrupted();
  /// Whether expire() may ever drop anything.
  bool may_expire() const { return options.deadline.count() > 0 || options.void_before; }
  /// Drops messages that are past their deadline, and those that were accepted before options.void_before.
  void expire(Instant now);
  /// When fire_timer() must be called (a message is to be tried again, or expires); nullopt: there is no timer.
  std::optional<Instant> next_timer() const;
  /// Handles the timer: drops expired messages, and ends the pause before a retry if it is over.
  void fire_timer(Instant now);
  /// Gives every message without an outcome the outcome `unknown`. \param under_way_numbers the numbers of those that
  /// are under way, which only the core knows
  void close(const std::vector<std::uint64_t>& under_way_numbers);

  bool closed = false;
  bool ready = false;  ///< the transport can send to the topic now: exchange and queue are declared where needed
  PublishLane* lane = nullptr;  ///< the lane in which it takes turns with other publishers; set once, when it is added
  bool in_runnable = false;     ///< listed in its lane
  bool in_report = false;       ///< listed in the core's list of publishers with something to report
  std::thread::id reporter;     ///< the thread that runs this publisher's callbacks; default value: none does

  std::size_t pending() const { return pending_; }
  bool has_report() const { return !events_.empty() || writable_due_; }
  /// Takes the outcomes that are to be reported; call reported() afterwards.
  std::vector<Event> take_events(bool& writable);
  void reported(std::size_t count) { pending_ -= count; }
  /// The same, and keeps the vector's memory for later events.
  void reported(std::vector<Event> events) {
    reported(events.size());
    events.clear();
    if (events_.empty() && events_.capacity() < events.capacity()) events_.swap(events);
  }

 private:
  void settle(std::uint64_t number, Outcome outcome, std::string reason);
  void insert(AcceptedMessage accepted);
  void trim();
  void forget_tries();

  std::deque<AcceptedMessage> waiting_;  ///< ascending numbers
  std::vector<Event> events_;
  std::uint64_t last_number_ = 0;
  std::size_t pending_ = 0;    ///< messages accepted whose outcome is not reported yet
  std::size_t under_way_ = 0;  ///< messages sent without an answer
  std::size_t put_off_in_row_ = 0;
  bool proven_ = false;
  bool unread_ = false;  ///< the last answer was that nobody reads the topic
  std::optional<Instant> retry_at_;
  unsigned unread_tries_ = 0;  ///< how often in a row that was the answer
  Backoff eager_, patient_;    ///< pauses while nobody reads the topic: at first, and later
  Backoff backoff_;            ///< pauses after the server could not store a message
  Backoff refusals_;           ///< pauses after a refusal for a reason that may pass
  std::string complaint_;      ///< that reason; empty after a confirmation
  bool wants_writable_ = false;
  bool writable_due_ = false;
};

}  // namespace iotcloud::brokers::client
