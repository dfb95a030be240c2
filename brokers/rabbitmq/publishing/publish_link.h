#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/outbox_timers.h"
#include "iotcloud/brokers/client/outcome_reporter.h"
#include "iotcloud/brokers/client/server_list.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/publishing/burst.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"

namespace iotcloud::brokers::rabbitmq {

using client::ConnectionLog;
using client::Instant;
using client::Outbox;
using client::Outgoing;

/// A publishing connection of a broker object.
///
/// Threads: callers of publish(), and one thread of the link's own. The *wire* (the AmqpLink) belongs to one thread at
/// a time, noted in `wire_busy_` under the mutex; the mutex itself is never held while bytes move. A caller takes the
/// wire only when it is free, nothing waits, and the socket's buffer has room: then it sends on its own thread, and
/// what other callers leave meanwhile. Everything else (answers, heartbeats, what must wait, connecting) is the link's
/// thread's.
class PublishLink {
 public:
  /// \param purpose shown by RabbitMQ's tools. The others outlive it.
  PublishLink(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
              ConnectionLog& log);
  ~PublishLink();
  PublishLink(const PublishLink&) = delete;
  PublishLink& operator=(const PublishLink&) = delete;

  std::shared_ptr<Outbox> add(const Topic& topic, const PublisherOptions& options);
  /// Closes the publisher: reports what has no outcome as unknown, waits for callbacks that run.
  void remove(const std::shared_ptr<Outbox>& outbox);
  PublishStatus publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past = {});
  /// Sends what was held back for the rest of a burst.
  void push();
  bool drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit);
  std::size_t pending(const Outbox& outbox) const;
  ConnectionState state() const;
  /// Called now and then by the broker's keeper: breaks a connection on which a send has stood still for too long
  /// (a server under a memory alarm takes nothing, for ever, and no time-out of the library helps).
  void watch();
  /// Whether it is time to find out if the preferred server answers, and what came of it: the connection moves back.
  bool must_ask_preferred() const;
  void preferred_answered(bool answers);

 private:
  using Lock = std::unique_lock<std::mutex>;
  struct UnderWay {
    std::shared_ptr<Outbox> outbox;
    Outgoing outgoing;
    bool returned = false;
    bool answered = false;
  };

  void run();
  void connect();
  void serve(bool readable, bool writable);
  void lose(const std::string& reason);
  /// Ends the connection for the preferred server's sake when nothing is under way any more, or it has taken too long.
  void move_back();
  /// Ends a connection on which the oldest message has no answer for too long.
  void check_answers();
  /// What was sent waits again, nothing is declared; the wire is gone or goes now, and is the caller's.
  void forget_connection();
  std::unique_ptr<AmqpLink> give_up_wire(Lock& lock);
  void acquire_wire(Lock& lock);
  void release_wire();

  void read_frames();
  void on_method(const amqp_method_t& method, amqp_channel_t channel);
  void on_returned(const amqp_basic_properties_t& properties);
  void on_answer(std::uint64_t tag, bool multiple, bool good);
  void on_channel_closed(const amqp_channel_close_t& closed);
  void settle(UnderWay& entry, bool good, Instant now);

  void declare_topics(Lock& lock);
  /// Sends what waits; the wire is the caller's. \param first_may_wait the socket said that it can be written
  void send_waiting(Lock& lock, std::size_t most, bool first_may_wait);
  void gather_waiting(Lock& lock, std::size_t most, bool first_may_wait);
  enum class Leaving {
    with_others,  ///< gathered: flush() is to follow
    in_a_burst,   ///< now, or a moment later with what follows: push() is to come
    at_once,
  };
  void send(Lock& lock, const std::shared_ptr<Outbox>& outbox, Outgoing outgoing, Leaving leaving);
  void push_held_back();
  void make_runnable(const std::shared_ptr<Outbox>& outbox);
  std::chrono::milliseconds time_to_sleep(Instant now);
  /// After every change of a publisher's messages. \return whether the thread sleeps for too long now.
  bool note(const std::shared_ptr<Outbox>& outbox);
  void wake(Lock& lock);
  /// Somebody waits for the answers: they are read as they come, until none is under way.
  void want_answers(Lock& lock);
  /// Before a message is sent: a sleeping thread need not wake up for its answer at once.
  void let_answers_gather();
  /// How long answers that nobody waits for may gather before they are read.
  static constexpr std::chrono::milliseconds gathering_time{2};
  static constexpr std::size_t most_gathered = 256;  ///< answers under way that nobody waits for
  void requeue_under_way();

  const Cluster& cluster_;
  const char* const purpose_;
  Meters& meters_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  LinkSleep sleep_;  ///< watch() and put_off(): with the mutex held

  // The wire: used by its owner only; replaced by the link's thread, with the mutex held too.
  std::unique_ptr<AmqpLink> wire_;
  MessageProperties properties_;
  bool reading_return_ = false;  ///< the header of a message that came back is next

  mutable std::mutex mutex_;
  std::condition_variable changed_;  ///< the wire became free, a callback ended
  // All below: guarded by mutex_.
  client::OutcomeReporter reporter_{changed_, meters_};
  client::OutboxTimers timers_;
  bool closing_ = false;
  bool connected_ = false;
  bool blocked_ = false;  ///< the server asked us to publish nothing (memory or disk alarm)
  bool wire_busy_ = false;
  bool wire_broken_ = false;  ///< a caller saw it fail; the link's thread cleans up
  bool sleeping_ = false;     ///< the link's thread polls
  /// Somebody waits for answers to what is under way. Otherwise the link's thread lets some gather before it reads
  /// them: being woken for each would cost more than sending did.
  bool answers_wanted_ = false;
  bool held_back_ = false;                            ///< the kernel may hold the end of what was sent: a burst goes on
  std::uint64_t wire_taken_ = 0;                      ///< so often
  std::uint64_t wire_taken_watched_ = 0;              ///< at the last look of watch()
  std::chrono::steady_clock::time_point busy_since_;  ///< when watch() saw first that it was taken this time
  std::uint64_t acknowledged_bytes_ = 0;              ///< by the peer's TCP at the last look of watch()
  std::vector<std::shared_ptr<Outbox>> outboxes_;
  std::vector<std::shared_ptr<Outbox>> undeclared_;
  std::deque<std::shared_ptr<Outbox>> runnable_;
  std::set<std::pair<std::string, bool>> declared_;  ///< exchanges on this connection
  std::deque<UnderWay> under_way_;                   ///< by publish tag, ascending
  std::uint64_t first_tag_ = 1;                      ///< of under_way_.front()
  std::size_t one_by_one_ = 0;  ///< so many messages still go alone: one of them made the server close the channel

  /// What check_answers() saw last: which message is the oldest under way, and since when.
  std::uint64_t awaited_tag_ = 0;
  Instant awaited_since_{};
  unsigned unanswered_ = 0;  ///< connections that ended for want of answers, not long one after the other
  Instant unanswered_at_{};  ///< the last of them

  bool stale_ = false;  ///< this connection knows only the dead leader of some queue; another one would do better
  Instant next_renewal_{};
  client::Backoff renewals_{std::chrono::milliseconds(1000), std::chrono::milliseconds(30'000)};
  client::ServerList servers_;
  std::optional<Instant> moving_since_;  ///< nothing new is sent: the connection is to move to the preferred server

  const std::shared_ptr<Reachable> reachable_ = std::make_shared<Reachable>(*this);
  std::thread thread_;
};

}  // namespace iotcloud::brokers::rabbitmq
