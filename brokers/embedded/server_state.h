#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "iotcloud/brokers/embedded/queue.h"

namespace iotcloud::brokers::embedded {

/// Queues of non-durable topics that nobody has read for this long vanish (as in RabbitMQ).
inline constexpr std::chrono::seconds idle_queue_limit{60};
/// A queue that holds more than this takes no more: publishers wait, each under its own policy.
inline constexpr std::size_t queue_bytes_limit = std::size_t{256} << 20;

struct Producer;

/// Where messages of one topic go.
struct Route {
  std::vector<std::shared_ptr<Queue>> queues;
  std::vector<Producer*> waiting;  ///< producers with messages that could not be routed yet
};

/// The server's side of one publisher. Guarded by the server's mutex, constants apart.
struct Producer : std::enable_shared_from_this<Producer> {
  struct Waiting {
    Message message;
    std::uint64_t number = 0;
    Instant accepted;
    bool old = false;  ///< an earlier process may have sent it
  };
  struct Event {
    std::uint64_t number = 0;
    Outcome outcome = Outcome::confirmed;
    const char* reason = "";
  };

  Topic topic;
  PublisherOptions options;
  Connection* connection = nullptr;  ///< outlives it

  std::shared_ptr<Route> route;
  std::deque<Waiting> waiting;
  std::vector<Event> events;  ///< outcomes that on_outcome has not seen yet
  std::uint64_t last_number = 0;
  std::size_t pending = 0;      ///< accepted, outcome not reported yet
  bool wants_writable = false;  ///< said would_block
  bool writable_due = false;    ///< on_writable is to be called
  bool in_report = false;       ///< stands in its connection's list of producers with something to report
  bool reporting = false;       ///< a thread is calling its callbacks
  bool timed = false;           ///< stands in its connection's list of producers whose messages grow old
  bool closed = false;
};

/// Connections to wake once the server's mutex is released: a thread that is woken while it is held would only run into
/// it and sleep again.
class WakeList {
 public:
  WakeList() = default;
  WakeList(const WakeList&) = delete;
  WakeList& operator=(const WakeList&) = delete;
  ~WakeList();
  /// Only connections whose thread sleeps are noted. The server's mutex is held.
  void add(Connection& connection);

 private:
  std::shared_ptr<Connection> first_;  ///< the usual case, without an allocation
  std::vector<std::shared_ptr<Connection>> others_;
};

/// All that stands behind one "embedded://NAME". `mutex` guards everything; functions that take a WakeList need it
/// held.
class ServerState {
 public:
  std::mutex mutex;

  bool running() const { return running_; }
  void stop(WakeList& wake);
  void start(WakeList& wake);
  void join(Connection& connection) { connections_.push_back(&connection); }
  void leave(Connection& connection) { std::erase(connections_, &connection); }

  std::shared_ptr<Route> route(const std::string& topic);
  /// The queue of a publisher with PublisherOptions::own_queue, now or when the server starts.
  void make_own_queue(const Topic& topic, Instant now);
  /// Gives one message to all queues bound to the route. \return false when there is none, one is full, or the server
  /// is away; the message is untouched then.
  bool deliver(Route& route, Producer::Waiting& waiting, const PublisherOptions& options, Instant now, WakeList& wake);
  /// Hands over what waits at this producer, as far as it goes.
  void flush(Producer& producer, Instant now, WakeList& wake);
  /// Drops what waits at this producer beyond its deadline.
  void expire(Producer& producer, Instant now, WakeList& wake);
  /// Notes an outcome, to be reported by the producer's connection.
  void settle(Producer& producer, std::uint64_t number, Outcome outcome, const char* reason, WakeList& wake);

  void attach(const std::shared_ptr<Consumer>& consumer, Instant now, WakeList& wake);
  void detach(Consumer& consumer, Instant now, WakeList& wake);
  /// Takes the next message for a consumer that can take one; nullopt when all that waited had expired.
  std::optional<Stored> take(Consumer& consumer, Instant now, WakeList& wake, std::size_t& conflated);
  /// Lets the readers of a queue know that there is something for them.
  void poke(Queue& queue, WakeList& wake);
  void poke(const std::shared_ptr<Consumer>& consumer, WakeList& wake);
  const Queue* find(const std::string& queue_name) const;
  /// Forgets queues that nobody uses any more and topics without queues and publishers; now and then.
  void sweep(Instant now);

 private:
  std::shared_ptr<Queue> bound_queue(const std::string& name, const Topic& topic, Instant now);
  void flush_waiting(Route& route, Instant now, WakeList& wake);
  void flush_topics_of(const Queue& queue, Instant now, WakeList& wake);
  void remove_idle(Route& route, Instant now);

  bool running_ = true;
  std::vector<Connection*> connections_;
  std::map<std::string, std::shared_ptr<Queue>> queues_;
  std::map<std::string, std::shared_ptr<Route>> routes_;  ///< by topic
  Instant last_sweep_{};
};

/// The queue that a group reads: `<topic>.<group>`, or the topic's own.
std::string queue_name(const std::string& topic, const std::string& group);

}  // namespace iotcloud::brokers::embedded
