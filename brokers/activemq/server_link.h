#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <proton/connection.hpp>
#include <proton/container.hpp>
#include <proton/messaging_handler.hpp>
#include <proton/receiver.hpp>
#include <proton/sender.hpp>

#include "iotcloud/brokers/activemq/statistics.h"
#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_list.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::activemq {

using client::ConnectionLog;
using Instant = config::Clock::Instant;

/// One connection to whichever server of a cluster is the right one: connects, connects again, says goodbye.
///
/// Everything of proton's is used on the container's one thread only (the I/O thread); the virtual functions are called
/// there, without the mutex. A derived class has its own state, guarded by `mutex_`, and calls wake() to have serve()
/// called soon. close() comes before the container stops, and that before its end.
class ServerLink : protected proton::messaging_handler {
 public:
  /// \param purpose for the server's list of connections. All references outlive this.
  ServerLink(proton::container& container, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
             std::string purpose, ConnectionLog& log);
  ~ServerLink() override = default;
  ServerLink(const ServerLink&) = delete;
  ServerLink& operator=(const ServerLink&) = delete;

  /// Connects for the first time; further calls do nothing. Thread safe.
  void start();
  /// Sends what is to be sent, closes the connection, and returns when the server agreed or did not within a second.
  /// Nothing is done any more after that. Not from the I/O thread.
  void close();

 protected:
  using Lock = std::unique_lock<std::mutex>;
  using Answer = std::function<void(const std::vector<QueueFacts>&)>;

  virtual void up() = 0;                  ///< there is a connection
  virtual void down() = 0;                ///< there is none any more: forget what belonged to it
  virtual void serve() = 0;               ///< do what is to be done; also called now and then
  virtual void say_goodbye() {}           ///< last chance to send something
  virtual std::size_t under_way() const;  ///< messages without an answer; 0 for one that sends none
  /// The server closed the connection with an error while exactly one message was under way.
  virtual void blame(const std::string& /*why*/) {}

  // On the I/O thread.
  /// Asks the server about its queues: names separated by commas, with wildcards. The answer comes later, unless the
  /// connection is lost first. Those that do not exist are not in it.
  void ask(const std::string& queues, Answer answer);
  /// Has serve() called at that time, if not earlier.
  void arm(Instant when);
  /// Gives the connection up, because it is of no use.
  void abandon(const std::string& why);
  proton::connection& connection() { return connection_; }
  proton::sender& sender() { return sender_; }
  Instant now() const { return clock_.now(); }
  bool blamed() const { return blamed_; }  ///< in down(): the server ended the connection, with an error
  /// Runs part of a callback; an exception ends the connection, not the thread.
  template <typename Function>
  void guarded(Function function) {
    try {
      function();
    } catch (const std::exception& error) {
      abandon(error.what());
    }
  }

  bool on_io_thread() const { return io_thread_ == std::this_thread::get_id(); }  // anywhere
  // With the mutex held.
  bool connected() const { return connected_; }
  void wake();

  void on_message(proton::delivery& delivery, proton::message& message) override;

  const BrokerOptions& options_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool closing_ = false;  ///< guarded by mutex_
  bool started_ = false;  ///< guarded by mutex_

 private:
  class Probe;
  enum class Phase { away, connecting, greeting, up };
  struct Question {
    std::vector<QueueFacts> facts;
    Answer answer;
    Instant asked;
  };

  void on_connection_open(proton::connection& connection) override;
  void on_connection_error(proton::connection& connection) override;
  void on_connection_wake(proton::connection& connection) override;
  void on_transport_close(proton::transport& transport) override;
  void on_transport_error(proton::transport& transport) override;
  void on_receiver_open(proton::receiver& receiver) override;
  void on_receiver_error(proton::receiver& receiver) override;
  void on_session_error(proton::session& session) override;
  void on_sender_error(proton::sender& sender) override;
  void on_error(const proton::error_condition& error) override;

  virtual void on_other_receiver_open(proton::receiver&) {}
  virtual void on_other_receiver_error(proton::receiver&) {}
  virtual void on_other_session_error(proton::session&) {}
  virtual void on_other_message(proton::delivery&, proton::message&) {}

  void post(std::function<void()> work);
  void tick();
  void look_after();
  void attempt(std::size_t server);
  proton::connection_options connection_options(const BrokerUrl& url) const;
  void greet();
  void answered(const proton::message& message);
  void lost(const std::string& why);
  /// From a timer: what a connection is given outside of its own callbacks waits until the next one before it is sent.
  void serve_in_its_turn();
  void run_serve();
  void finish();

  proton::container& container_;
  std::atomic<std::thread::id> io_thread_;
  const std::vector<BrokerUrl> urls_;
  const std::string purpose_;
  const config::Clock& clock_;
  ConnectionLog& log_;

  bool connected_ = false;         ///< guarded by mutex_
  bool woken_ = false;             ///< guarded by mutex_
  proton::connection connection_;  ///< changed on the I/O thread, with the mutex held

  // The I/O thread's.
  Phase phase_ = Phase::away;
  client::ServerList servers_;
  std::size_t server_ = 0;
  Instant attempt_ends_{};
  Instant armed_ = Instant::max();
  std::string trouble_;  ///< why the connection ends
  bool blamed_ = false;  ///< the server ended it, with an error
  bool moving_back_ = false;
  proton::sender sender_;
  proton::receiver answers_;
  std::string answers_address_;
  std::map<std::uint64_t, Question> questions_;
  std::uint64_t last_question_ = 0;
  std::shared_ptr<Probe> probe_;
};

}  // namespace iotcloud::brokers::activemq
