#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include <amqp.h>

#include "iotcloud/brokers/client/ack_window.h"
#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/rabbitmq/consuming/resent_marks.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::rabbitmq {

using client::AckWindow;
using client::Arrived;
using client::Backoff;

class ConsumeLink;

/// Puts the frames of one delivery together: its method, its header, its body's pieces. One copy of the body.
class Assembly {
 public:
  void begin(const amqp_basic_deliver_t& deliver);
  /// Both return the message when it is complete. \throws LinkError when the frames make no sense.
  std::optional<Arrived> header(const amqp_frame_t& frame, ResentMarks& resent);
  std::optional<Arrived> body(amqp_bytes_t piece);
  /// Whether the delivery under way, or the one returned last, is one that no handler should get: it has more headers
  /// than a sane one, and they were not read.
  bool hostile() const { return hostile_; }
  void reset() { *this = Assembly(); }

 private:
  std::optional<Arrived> finish();

  Arrived arrived_;
  bool expects_header_ = false;
  bool hostile_ = false;
  std::shared_ptr<std::byte[]> bytes_;
  std::size_t size_ = 0;
  std::size_t filled_ = 0;
};

/// One subscription as its connection sees it. Guarded by the mutex of its home, constants apart.
class Inlet final : public Settler, public std::enable_shared_from_this<Inlet> {
 public:
  enum class Phase {
    idle,     ///< no channel: not connected, or waiting for `retry_at`
    opening,  ///< asked for; the answer is due until `retry_at`
    active,   ///< reads
  };

  Inlet(std::shared_ptr<ConsumeLink> link, Topic to, SubscriptionOptions how, Handler what);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;
  /// The link it reads through; another one when its server has no channel left for it. Thread safe.
  std::shared_ptr<ConsumeLink> home() const;
  void move_to(std::shared_ptr<ConsumeLink> link);

  const Topic topic;
  const SubscriptionOptions options;
  const Handler handler;
  const std::string queue;

  Phase phase = Phase::idle;
  std::optional<config::Clock::Instant> retry_at;
  Backoff backoff{std::chrono::milliseconds(100), std::chrono::milliseconds(2000)};
  amqp_channel_t channel = 0;
  std::uint64_t generation = 0;   ///< counts channels, so that late settlements of an earlier one are known as such
  bool passive_exchange = false;  ///< it exists with other properties: take it as it is
  bool passive_queue = false;
  std::string complaint;  ///< the last that was logged, so that it is logged once
  AckWindow window;
  Assembly assembly;
  ResentMarks resent;
  bool read_before = false;  ///< was active once, on whatever channel
  /// Messages to come that may have been handed on already although the server does not say so: a server that was
  /// killed forgets what it had delivered. What waits in the queue when we come back is counted as such.
  std::uint32_t doubtful = 0;
  bool paused = false;
  bool closed = false;
  bool running = false;   ///< its handler runs
  bool quick = false;     ///< its handler was, the last time that it was measured; the link's thread's own
  bool in_ready = false;  ///< stands in the link's list of those with something to hand on
  bool in_dirty = false;  ///< stands in the link's list of those with settlements to send

  bool has_work() const { return window.waiting() > 0 && !paused && !closed; }
  std::size_t patience() const { return options.prefetch / 2U; }
  /// What the user's Delivery carries: the tag, made unique over all channels of this subscription.
  std::uint64_t public_tag(std::uint64_t tag) const { return generation << 48U | tag; }
  void forget_channel();

 private:
  mutable std::mutex home_mutex_;
  std::shared_ptr<ConsumeLink> home_;  ///< guarded by home_mutex_; changed with the mutexes of both links held too
};

}  // namespace iotcloud::brokers::rabbitmq
