#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "iotcloud/brokers/activemq/engine.h"
#include "iotcloud/brokers/activemq/io_loop.h"
#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_list.h"
#include "iotcloud/brokers/client/server_probe.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::activemq {

using client::ConnectionLog;
using Instant = config::Clock::Instant;

/// The clock of a broker object.
const config::Clock& clock_of(const BrokerOptions& options);

/// One connection to the server of a cluster that a ServerList chooses: connects, reconnects and closes it in order.
///
/// Everything, the engine included, is guarded by `mutex_`: any thread that holds it may send. The virtual functions
/// below are called with the mutex held. The loop's serving thread reads what the server sends.
class ServerLink : public IoLoop::Service {
 public:
  /// \param mutex guards this object. \param purpose for the server's list of connections. All referenced objects
  /// outlive this one.
  ServerLink(config::Mutex& mutex, IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
             std::string purpose, ConnectionLog& log, ServerTrust& trust);
  ServerLink(const ServerLink&) = delete;
  ServerLink& operator=(const ServerLink&) = delete;

  /// Connects for the first time; further calls do nothing. Thread safe.
  void start();
  /// Sends what waits and closes the connection. Returns when the server has closed its end, after a second at most;
  /// afterwards the link does nothing any more. Not to be called from the loop's threads.
  void close();

  Wish wish() override;
  void serve(bool readable, bool writable) override;
  void flush() override;

 protected:
  /// How often a connection is checked, and whether an answer is overdue, if no event arrives.
  static constexpr std::chrono::milliseconds look_period{250};
  using Answer = std::function<void(const std::vector<QueueFacts>&)>;

  virtual void up() IOTCLOUD_REQUIRES(mutex_) = 0;          ///< the connection is open
  virtual void down() IOTCLOUD_REQUIRES(mutex_) = 0;        ///< the connection is lost: forget what belonged to it
  virtual void work() IOTCLOUD_REQUIRES(mutex_) = 0;        ///< do the work that is due; also called periodically
  virtual void before_flush() IOTCLOUD_REQUIRES(mutex_) {}  ///< hand over messages that waited to be sent together
  /// The connection is about to be closed: last chance to send.
  virtual void say_goodbye() IOTCLOUD_REQUIRES(mutex_) {}
  virtual void report() IOTCLOUD_REQUIRES(mutex_) {}  ///< calls users' callbacks with the mutex released
  /// The number of messages without an answer.
  virtual std::size_t under_way() const IOTCLOUD_REQUIRES(mutex_) { return 0; }
  /// The server closed the connection with an error while exactly one message was under way.
  virtual void blame(const std::string& /*why*/) IOTCLOUD_REQUIRES(mutex_) {}

  virtual void on_receiver_open(pn_link_t* /*receiver*/) IOTCLOUD_REQUIRES(mutex_) {}
  virtual void on_receiver_closed(pn_link_t* /*receiver*/, const std::string& /*why*/) IOTCLOUD_REQUIRES(mutex_) {}
  /// The server has opened a session that a derived class opened.
  virtual void on_session_open(pn_session_t* /*session*/) IOTCLOUD_REQUIRES(mutex_) {}
  virtual void on_session_closed(pn_session_t* /*session*/, const std::string& /*why*/) IOTCLOUD_REQUIRES(mutex_) {}
  virtual void on_message(pn_delivery_t* /*delivery*/, const WireBytes& /*message*/) IOTCLOUD_REQUIRES(mutex_) {}
  /// The server's outcome for a sent message: PN_ACCEPTED, PN_REJECTED, ...
  virtual void on_outcome(pn_delivery_t* /*delivery*/, std::uint64_t /*outcome*/) IOTCLOUD_REQUIRES(mutex_) {}

  /// Asks the server about its queues: names separated by commas, with wildcards. `answer` is called later with the
  /// queues that exist, unless the connection is lost first.
  void ask(const std::string& queues, Answer answer) IOTCLOUD_REQUIRES(mutex_);
  /// start(), with the mutex held.
  void begin() IOTCLOUD_REQUIRES(mutex_);
  /// Has work() called at that time or earlier.
  void arm(Instant when) IOTCLOUD_REQUIRES(mutex_) { armed_ = std::min(armed_, when); }
  /// Has work() called soon.
  void wake() IOTCLOUD_REQUIRES(mutex_);
  /// Ends the connection, because it is unusable.
  void abandon(const std::string& why) IOTCLOUD_REQUIRES(mutex_);
  /// Runs a function; an exception that it throws ends the connection, not the thread.
  template <typename Function>
  void guarded(Function function) noexcept IOTCLOUD_REQUIRES(mutex_) {
    try {
      function();
    } catch (const std::exception& error) {
      abandon(error.what());
    }
  }

  /// Whether the answer to what the server was asked then is overdue.
  bool has_waited_too_long(Instant asked) const IOTCLOUD_REQUIRES(mutex_);
  bool connected() const IOTCLOUD_REQUIRES(mutex_) { return phase_ == Phase::up; }
  Engine& engine() IOTCLOUD_REQUIRES(mutex_) { return *engine_; }
  pn_link_t* sender() IOTCLOUD_REQUIRES(mutex_) { return sender_; }
  pn_session_t* session() IOTCLOUD_REQUIRES(mutex_) { return session_; }
  std::uint64_t next_tag() IOTCLOUD_REQUIRES(mutex_) { return ++last_tag_; }
  Instant now() const { return clock_.now(); }
  /// For down(): whether the server closed the connection with an error.
  bool blamed() const IOTCLOUD_REQUIRES(mutex_) { return blamed_; }

  IoLoop& loop_;
  const BrokerOptions& options_;
  config::Mutex& mutex_;
  config::ConditionVariable changed_;
  bool closing_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool started_ IOTCLOUD_GUARDED_BY(mutex_) = false;

 private:
  enum class Phase { away, connecting, greeting, up };
  struct Question {
    std::vector<QueueFacts> facts;
    Answer answer;
    Instant asked;
  };

  void look_after() IOTCLOUD_REQUIRES(mutex_);
  /// Ends the connection if its server is not trusted any more. \return whether it goes on
  bool look_after_trust() IOTCLOUD_REQUIRES(mutex_);
  void look_after_preferred() IOTCLOUD_REQUIRES(mutex_);
  void attempt(std::size_t server) IOTCLOUD_REQUIRES(mutex_);
  void dispatch() IOTCLOUD_REQUIRES(mutex_);
  void handle(pn_event_t* event) IOTCLOUD_REQUIRES(mutex_);
  void on_remote_close() IOTCLOUD_REQUIRES(mutex_);
  void on_session_remote_close(pn_session_t* session) IOTCLOUD_REQUIRES(mutex_);
  void on_link_remote_close(pn_link_t* link) IOTCLOUD_REQUIRES(mutex_);
  void on_delivery(pn_delivery_t* delivery) IOTCLOUD_REQUIRES(mutex_);
  void greet() IOTCLOUD_REQUIRES(mutex_);
  void greeted() IOTCLOUD_REQUIRES(mutex_);
  void answered(std::string_view message) IOTCLOUD_REQUIRES(mutex_);
  void lost(const std::string& why) IOTCLOUD_REQUIRES(mutex_);
  void finish() IOTCLOUD_REQUIRES(mutex_);

  const std::vector<BrokerUrl> urls_;
  const std::string purpose_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  ServerTrust& trust_;

  std::unique_ptr<Engine> engine_ IOTCLOUD_GUARDED_BY(mutex_);
  /// A lost connection's engine, kept until nothing refers to it.
  std::unique_ptr<Engine> lost_engine_ IOTCLOUD_GUARDED_BY(mutex_);
  bool woken_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool goodbye_said_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  Instant armed_ = Instant::max();
  Instant next_look_ IOTCLOUD_GUARDED_BY(mutex_){};
  Phase phase_ IOTCLOUD_GUARDED_BY(mutex_) = Phase::away;
  client::ServerList servers_ IOTCLOUD_GUARDED_BY(mutex_);
  client::ServerProbe probe_;  ///< of the preferred server, while the link is connected to another
  std::size_t server_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  Instant heard_ IOTCLOUD_GUARDED_BY(mutex_){};  ///< when the server last sent something
  Instant attempt_ends_ IOTCLOUD_GUARDED_BY(mutex_){};
  bool blamed_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< the server closed the connection with an error
  bool moving_back_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  pn_session_t* session_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;
  pn_link_t* sender_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;
  pn_link_t* answers_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;
  std::string answers_address_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::uint64_t, Question> questions_ IOTCLOUD_GUARDED_BY(mutex_);
  std::uint64_t last_question_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::uint64_t last_tag_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

}  // namespace iotcloud::brokers::activemq
