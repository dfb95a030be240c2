#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "iotcloud/brokers/embedded/queue.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::embedded {

/// The queue of a non-durable topic is removed when it has had no reader for this long (as in RabbitMQ).
inline constexpr std::chrono::seconds idle_queue_limit{60};
/// A queue with more bytes than this takes no more messages: messages wait at their publishers, as `when_full` says.
inline constexpr std::size_t queue_bytes_limit = std::size_t{256} << 20;

struct ServerPublisher;

/// The queues of one topic.
struct Route {
  std::vector<std::shared_ptr<Queue>> queues;
  std::vector<ServerPublisher*> waiting;  ///< publishers with messages that could not be delivered yet
};

/// The server's side of one publisher. Guarded by the server's mutex, except constants.
struct ServerPublisher : std::enable_shared_from_this<ServerPublisher> {
  struct Waiting {
    Message message;
    std::uint64_t number = 0;
    Instant accepted;
    bool old = false;  ///< an earlier process may have sent it already
  };
  struct Event {
    std::uint64_t number = 0;
    Outcome outcome = Outcome::confirmed;
    const char* reason = "";
  };

  Topic topic;
  PublisherOptions options;
  EmbeddedConnection* connection = nullptr;  ///< must outlive the publisher

  std::shared_ptr<Route> route;
  std::deque<Waiting> waiting;
  std::vector<Event> events;  ///< outcomes to report to on_outcome
  std::uint64_t last_number = 0;
  std::size_t pending = 0;      ///< accepted messages whose outcome was not reported yet
  bool wants_writable = false;  ///< publish() answered would_block
  bool writable_due = false;    ///< on_writable must be called
  bool in_report = false;       ///< is in EmbeddedConnection::to_report
  bool reporting = false;       ///< a thread is calling its callbacks
  bool timed = false;           ///< is in EmbeddedConnection::timed
  bool closed = false;
};

/// Collects connections, and wakes their threads when it is destroyed. Declare it before the lock of the server's
/// mutex: a thread that is woken before the mutex is released would only block on it.
class WakeList {
 public:
  WakeList() = default;
  WakeList(const WakeList&) = delete;
  WakeList& operator=(const WakeList&) = delete;
  ~WakeList();
  /// Adds a connection if its thread sleeps. The caller holds the server's mutex.
  void add(EmbeddedConnection& connection);

 private:
  std::shared_ptr<EmbeddedConnection> first_;  ///< one connection is the usual case, which needs no allocation
  std::vector<std::shared_ptr<EmbeddedConnection>> others_;
};

/// The server behind one "embedded://NAME". `mutex` also guards its connections, publishers, consumers and queues.
class ServerState {
 public:
  config::Mutex mutex;

  bool running() const IOTCLOUD_REQUIRES(mutex) { return running_; }
  void stop(WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void start(WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void join(EmbeddedConnection& connection) IOTCLOUD_REQUIRES(mutex) { connections_.push_back(&connection); }
  void leave(EmbeddedConnection& connection) IOTCLOUD_REQUIRES(mutex) { std::erase(connections_, &connection); }

  std::shared_ptr<Route> route(const std::string& topic) IOTCLOUD_REQUIRES(mutex);
  /// Makes the queue of a publisher with PublisherOptions::own_queue, now or when the server starts.
  void make_own_queue(const Topic& topic, Instant now) IOTCLOUD_REQUIRES(mutex);
  /// Gives one message to all queues of the route. \return false if there is no queue, one is full, or the server is
  /// away; the message is then unchanged.
  bool deliver(Route& route, ServerPublisher::Waiting& waiting, const PublisherOptions& options, Instant now,
               WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  /// Delivers this publisher's waiting messages, as many as possible.
  void flush(ServerPublisher& publisher, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  /// Drops this publisher's waiting messages that are past their deadline, or fenced (PublisherOptions::void_before).
  void expire(ServerPublisher& publisher, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  /// Records an outcome, which the thread of the publisher's connection reports.
  void settle(ServerPublisher& publisher, std::uint64_t number, Outcome outcome, const char* reason, WakeList& wake)
      IOTCLOUD_REQUIRES(mutex);

  void attach(const std::shared_ptr<Consumer>& consumer, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void detach(Consumer& consumer, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  /// Takes the next message for a consumer that can take one; nullopt if all waiting messages had expired. \param
  /// conflated set to the number of messages that keep_last dropped.
  std::optional<StoredMessage> take(Consumer& consumer, Instant now, WakeList& wake, std::size_t& conflated)
      IOTCLOUD_REQUIRES(mutex);
  /// Puts the readers of a queue that can take messages on their connections' list `ready`, and wakes those
  /// connections.
  void make_ready(Queue& queue, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void make_ready(const std::shared_ptr<Consumer>& consumer, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  const Queue* find(const std::string& queue_name) const IOTCLOUD_REQUIRES(mutex);
  /// Removes the queue if it has no reader and no message.
  void remove_unneeded(const std::string& queue_name) IOTCLOUD_REQUIRES(mutex);
  /// Removes idle queues, and topics without queues and publishers; does nothing if it did so within idle_queue_limit.
  void sweep(Instant now) IOTCLOUD_REQUIRES(mutex);

 private:
  std::shared_ptr<Queue> bound_queue(const std::string& name, const Topic& topic, Instant now) IOTCLOUD_REQUIRES(mutex);
  void flush_waiting(Route& route, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void flush_topics_of(const Queue& queue, Instant now, WakeList& wake) IOTCLOUD_REQUIRES(mutex);
  void remove_idle(Route& route, Instant now) IOTCLOUD_REQUIRES(mutex);

  bool running_ IOTCLOUD_GUARDED_BY(mutex) = true;
  std::vector<EmbeddedConnection*> connections_ IOTCLOUD_GUARDED_BY(mutex);
  std::map<std::string, std::shared_ptr<Queue>> queues_ IOTCLOUD_GUARDED_BY(mutex);
  std::map<std::string, std::shared_ptr<Route>> routes_ IOTCLOUD_GUARDED_BY(mutex);  ///< by topic
  Instant last_sweep_ IOTCLOUD_GUARDED_BY(mutex){};
};

/// The name of a group's queue: `<topic>.<group>`; for an empty group that of the topic's own queue, `<topic>`.
std::string queue_name(const std::string& topic, const std::string& group);

}  // namespace iotcloud::brokers::embedded
