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

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_list.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/consuming/inlet.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"

namespace iotcloud::brokers::rabbitmq {

using client::ConnectionLog;

/// A consuming connection of a broker object, with the one thread that reads it and runs the handlers.
///
/// Each subscription has a channel of its own, because a refusal (another reader is exclusive) closes the channel.
/// Nothing here waits for the server's answers: requests are sent one after the other and the answers taken as they
/// come, so the mutex is held for short times only and whoever holds it may use the connection. While a handler runs
/// long, the broker's keeper does so (attend()): it reads what comes, up to the prefetch, answers heartbeats, and sends
/// settlements.
class ConsumeLink : public std::enable_shared_from_this<ConsumeLink> {
 public:
  /// \param purpose shown by RabbitMQ's tools. The others outlive close().
  ConsumeLink(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
              ConnectionLog& log);
  ~ConsumeLink() = default;
  ConsumeLink(const ConsumeLink&) = delete;
  ConsumeLink& operator=(const ConsumeLink&) = delete;
  /// Closes the connection and ends the thread, if there is one. Not from a handler.
  void close();

  /// The first one starts the thread, which connects.
  std::shared_ptr<Inlet> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler does not run any more, unless called from it.
  /// These are false, and nothing is done, when the subscription has moved to another link: ask its home().
  bool remove(const std::shared_ptr<Inlet>& inlet);
  bool pause(Inlet& inlet);
  bool resume(const std::shared_ptr<Inlet>& inlet);
  bool active(const Inlet& inlet) const;
  void settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection
  /// Called now and then by the broker's keeper.
  void attend();
  bool has_room() const;  ///< for one more subscription
  bool crowded() const;   ///< it has more than its server allows channels
  /// Gives what it cannot read itself to another link, as much as that one takes.
  void share(ConsumeLink& other);
  /// Whether it is time to find out if the preferred server answers, and what came of it: the connection moves back.
  bool must_ask_preferred() const;
  void preferred_answered(bool answers);

 private:
  using Lock = std::unique_lock<std::mutex>;

  void run();
  void connect(Lock& lock);
  void lose(const std::string& reason);
  /// Ends the connection for the preferred server's sake when nothing is handed on any more, or it has taken too long.
  void move_back(Lock& lock);
  void forget_connection();
  bool at_home(const Inlet& inlet) const { return inlet.home().get() == this; }
  void start();
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
  amqp_channel_t free_channel() const;
  void check_timers();
  void send_settlements(Inlet& inlet, std::size_t patience);
  bool settlements_due() const;
  void send_all_settlements();
  void set_timer(Inlet& inlet, config::Clock::Instant at);

  void make_ready(const std::shared_ptr<Inlet>& inlet);
  void retry_later(Inlet& inlet);
  std::chrono::milliseconds time_to_sleep() const;

  const Cluster& cluster_;
  const char* const purpose_;
  Meters& meters_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  LinkSleep sleep_;  ///< watch(): with the mutex held

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
  std::deque<std::shared_ptr<Inlet>> ready_;
  std::vector<std::shared_ptr<Inlet>> dirty_;
  config::Clock::Instant settled_at_{};               ///< when settlements were sent last
  std::optional<config::Clock::Instant> next_timer_;  ///< no inlet's retry_at is earlier, but see openers_wait_
  bool openers_wait_ = false;  ///< some are due to be opened when the server has answered earlier ones

  std::size_t channel_limit_;  ///< what we ask for, then what the server allows
  client::ServerList servers_;
  std::optional<config::Clock::Instant> moving_since_;  ///< nothing is handed on: the connection is to move

  std::thread thread_;
};

}  // namespace iotcloud::brokers::rabbitmq
