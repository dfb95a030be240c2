#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/inlet.h"

namespace iotcloud::brokers::rabbitmq {

using client::ConnectionLog;
using client::WakeEvent;

/// The consuming connection of one broker object, with the one thread that reads it and runs the handlers.
///
/// Each subscription has a channel of its own, because a refusal (another reader is exclusive) closes the channel.
/// Nothing here waits for the server's answers: requests are sent one after the other and the answers taken as they
/// come, so the mutex is held for short times only and whoever holds it may use the connection. While a handler runs
/// long, the broker's keeper does so (attend()): it reads what comes, up to the prefetch, answers heartbeats, and sends
/// settlements.
class ConsumeLink : public std::enable_shared_from_this<ConsumeLink> {
 public:
  ConsumeLink(LinkOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log);
  ~ConsumeLink() = default;
  ConsumeLink(const ConsumeLink&) = delete;
  ConsumeLink& operator=(const ConsumeLink&) = delete;
  /// Closes the connection and ends the thread, if there is one. Not from a handler.
  void close();

  /// The first one starts the thread, which connects.
  std::shared_ptr<Inlet> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler does not run any more, unless called from it.
  void remove(const std::shared_ptr<Inlet>& inlet);
  void pause(Inlet& inlet);
  void resume(const std::shared_ptr<Inlet>& inlet);
  bool active(const Inlet& inlet) const;
  void settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection
  /// Called now and then by the broker's keeper.
  void attend();

 private:
  using Lock = std::unique_lock<std::mutex>;

  void run();
  void connect(Lock& lock);
  void lose(const std::string& reason);
  void hand_on(Lock& lock, std::size_t most);
  void run_handler(const Inlet& inlet, Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag);
  void wake();

  // With the mutex held; these use the connection and throw LinkError.
  void read_frames();
  void on_frame(const amqp_frame_t& frame);
  void on_method(const amqp_method_t& method, amqp_channel_t channel);
  void on_channel_closed(const std::shared_ptr<Inlet>& inlet, const amqp_channel_close_t& closed);
  void on_arrived(const std::shared_ptr<Inlet>& inlet, Arrived arrived);
  void open(const std::shared_ptr<Inlet>& inlet);
  void request_queue(const Inlet& inlet);
  void close_channel(Inlet& inlet);
  void check_timers();
  void send_settlements(Inlet& inlet, std::size_t patience);
  bool settlements_due() const;
  void send_all_settlements();
  void set_timer(Inlet& inlet, config::Clock::Instant at);

  void make_ready(const std::shared_ptr<Inlet>& inlet);
  void retry_later(Inlet& inlet);
  std::chrono::milliseconds time_to_sleep() const;

  const LinkOptions options_;
  Meters& meters_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  WakeEvent wake_event_;

  mutable std::mutex mutex_;
  std::condition_variable handler_ended_;
  // All below: guarded by mutex_.
  std::unique_ptr<AmqpLink> wire_;  ///< replaced by the link's thread only
  bool started_ = false;
  bool closing_ = false;
  bool broken_ = false;    ///< another thread saw the connection fail
  bool sleeping_ = false;  ///< the thread polls
  bool handling_ = false;  ///< the thread runs a handler
  std::vector<std::shared_ptr<Inlet>> inlets_;
  std::map<amqp_channel_t, std::shared_ptr<Inlet>> channels_;  ///< null: closing, the answer is still to come
  amqp_channel_t last_channel_ = 0;
  std::deque<std::shared_ptr<Inlet>> ready_;
  std::vector<std::shared_ptr<Inlet>> dirty_;
  config::Clock::Instant settled_at_{};               ///< when settlements were sent last
  std::optional<config::Clock::Instant> next_timer_;  ///< no inlet's retry_at is earlier

  // The link's thread's.
  Backoff backoff_{std::chrono::milliseconds(50), std::chrono::milliseconds(2000)};
  config::Clock::Instant next_attempt_{};
  config::Clock::Instant connected_at_{};
  std::thread thread_;
};

}  // namespace iotcloud::brokers::rabbitmq
