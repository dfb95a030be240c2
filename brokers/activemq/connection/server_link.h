#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "iotcloud/brokers/activemq/connection/engine.h"
#include "iotcloud/brokers/activemq/connection/io_loop.h"
#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_list.h"
#include "iotcloud/brokers/client/server_probe.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::activemq {

using client::ConnectionLog;
using Instant = config::Clock::Instant;

/// One connection to whichever server of a cluster is the right one: connects, connects again, says goodbye.
///
/// Everything is guarded by `mutex_`, the engine too: whoever holds it may send. The virtual functions below are called
/// with it held. What the server sends is taken in on the loop's thread that serves.
class ServerLink : public IoLoop::Service {
 public:
  /// \param purpose for the server's list of connections. All references outlive this.
  ServerLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls, std::string purpose,
             ConnectionLog& log);
  ServerLink(const ServerLink&) = delete;
  ServerLink& operator=(const ServerLink&) = delete;

  /// Connects for the first time; further calls do nothing. Thread safe.
  void start();
  /// Sends what is to be sent, closes the connection, and returns when the server agreed or did not within a second.
  /// Nothing is done any more after that. Not from the loop's threads.
  void close();

  Wish wish() override;
  void serve(bool readable, bool writable) override;
  void flush() override;

 protected:
  using Lock = std::unique_lock<std::mutex>;
  using Answer = std::function<void(const std::vector<QueueFacts>&)>;

  virtual void up() = 0;                               ///< there is a connection
  virtual void down() = 0;                             ///< there is none any more: forget what belonged to it
  virtual void work() = 0;                             ///< do what is to be done; also called now and then
  virtual void before_flush() {}                       ///< what waited for others to be sent with
  virtual void say_goodbye() {}                        ///< last chance to send something
  virtual void report(Lock& /*lock*/) {}               ///< calls callbacks, without the mutex
  virtual std::size_t under_way() const { return 0; }  ///< messages without an answer
  /// The server closed the connection with an error while exactly one message was under way.
  virtual void blame(const std::string& /*why*/) {}

  virtual void on_receiver_open(pn_link_t* /*receiver*/) {}
  virtual void on_receiver_closed(pn_link_t* /*receiver*/, const std::string& /*why*/) {}
  virtual void on_session_closed(pn_session_t* /*session*/, const std::string& /*why*/) {}
  virtual void on_message(pn_delivery_t* /*delivery*/, const WireBytes& /*message*/) {}
  /// What became of a message that was sent: PN_ACCEPTED, PN_REJECTED, ...
  virtual void on_outcome(pn_delivery_t* /*delivery*/, std::uint64_t /*outcome*/) {}

  /// Asks the server about its queues: names separated by commas, with wildcards. The answer comes later, unless the
  /// connection is lost first. Those that do not exist are not in it.
  void ask(const std::string& queues, Answer answer);
  /// Has work() called at that time, if not earlier.
  void arm(Instant when) { armed_ = std::min(armed_, when); }
  /// Has work() called soon.
  void wake();
  /// Gives the connection up, because it is of no use.
  void abandon(const std::string& why);
  /// Runs something that may fail; an exception ends the connection, not the thread.
  template <typename Function>
  void guarded(Function function) noexcept {
    try {
      function();
    } catch (const std::exception& error) {
      abandon(error.what());
    }
  }

  bool connected() const { return phase_ == Phase::up; }
  Engine& engine() { return *engine_; }
  pn_link_t* sender() { return sender_; }
  pn_session_t* session() { return session_; }
  std::uint64_t next_tag() { return ++last_tag_; }
  Instant now() const { return clock_.now(); }
  bool blamed() const { return blamed_; }  ///< in down(): the server ended the connection, with an error

  IoLoop& loop_;
  const BrokerOptions& options_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool closing_ = false;
  bool started_ = false;

 private:
  enum class Phase { away, connecting, greeting, up };
  struct Question {
    std::vector<QueueFacts> facts;
    Answer answer;
    Instant asked;
  };

  void look_after(Lock& lock);
  void look_after_preferred(Lock& lock);
  void attempt(Lock& lock, std::size_t server);
  void dispatch();
  void handle(pn_event_t* event);
  void on_remote_close();
  void on_session_remote_close(pn_session_t* session);
  void on_link_remote_close(pn_link_t* link);
  void on_delivery(pn_delivery_t* delivery);
  void greet();
  void greeted();
  void answered(std::string_view message);
  void lost(const std::string& why);
  void finish();

  const std::vector<BrokerUrl> urls_;
  const std::string purpose_;
  const config::Clock& clock_;
  ConnectionLog& log_;

  // Guarded by mutex_.
  std::unique_ptr<Engine> engine_;
  std::unique_ptr<Engine> lost_engine_;  ///< until nothing refers to it any more
  bool woken_ = false;
  bool goodbye_said_ = false;
  Instant armed_ = Instant::max();
  Instant next_look_{};
  Phase phase_ = Phase::away;
  client::ServerList servers_;
  client::ServerProbe probe_;  ///< of the preferred server, while the link is connected to another
  std::size_t server_ = 0;
  Instant attempt_ends_{};
  bool blamed_ = false;  ///< the server ended it, with an error
  bool moving_back_ = false;
  pn_session_t* session_ = nullptr;
  pn_link_t* sender_ = nullptr;
  pn_link_t* answers_ = nullptr;
  std::string answers_address_;
  std::map<std::uint64_t, Question> questions_;
  std::uint64_t last_question_ = 0;
  std::uint64_t last_tag_ = 0;
};

}  // namespace iotcloud::brokers::activemq
