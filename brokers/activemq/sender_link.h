#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "iotcloud/brokers/activemq/server_link.h"
#include "iotcloud/brokers/client/publish_core.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::activemq {

using client::Outbox;
using client::PublishCore;
using client::UnderWay;

/// A publisher's messages and the address to which they go. Guarded by the core's mutex.
class RoutedOutbox final : public Outbox {
 public:
  RoutedOutbox(const Topic& to, const PublisherOptions& how);
  /// Whether it is known which queues the topic has. The server accepts messages for a topic without queues and loses
  /// them, so a publisher asks before the first message, and again from time to time.
  enum class Route { unknown, asked, known };
  const std::string own_queue;
  Route route = Route::unknown;
  std::string address;  ///< the address to send to, when the route is known
  bool own_queue_exists = false;
  Instant asked_at{};
};

/// A base class, so that the core is constructed before the ServerLink, which the core's mutex guards.
struct SenderCore {
  SenderCore(client::PublishTransport& transport, Meters& meters, const config::Clock& clock)
      : core_(transport, meters, clock) {}
  PublishCore core_;
};

/// The publishing connection of one broker object: the transport of a PublishCore. Callers of publish() send on their
/// own thread, as far as the socket takes it; the loop does the rest. All messages go over one AMQP link, so that
/// messages of a topic keep their order even if their addresses differ.
class SenderLink final : client::PublishTransport, SenderCore, public ServerLink {
 public:
  SenderLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls, std::string purpose,
             Meters& meters, ConnectionLog& log, ServerTrust& trust);

  /// The core, to which publishers are added.
  PublishCore& core() { return core_; }
  ConnectionState state() const;

 private:
  /// Tells the thread safety analysis that the core's mutex, which is the link's, is held.
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(core_.mutex) {}

  // The PublishTransport.
  std::shared_ptr<Outbox> make_outbox(const Topic& topic, const PublisherOptions& options) override {
    return std::make_shared<RoutedOutbox>(topic, options);
  }
  void added(const std::shared_ptr<Outbox>& outbox) override IOTCLOUD_REQUIRES(mutex_);
  Room room(const std::shared_ptr<Outbox>& outbox, const Message& next, bool alone) override IOTCLOUD_REQUIRES(mutex_);
  void send(UnderWay& message) override IOTCLOUD_REQUIRES(mutex_);
  void send_gathered() override IOTCLOUD_REQUIRES(mutex_);
  void broke(const char* why) noexcept override IOTCLOUD_REQUIRES(mutex_);
  void left_waiting(const std::shared_ptr<Outbox>& outbox, Instant now) override IOTCLOUD_REQUIRES(mutex_);
  void want_answers() override IOTCLOUD_REQUIRES(mutex_);
  void wake() noexcept override IOTCLOUD_REQUIRES(mutex_) { ServerLink::wake(); }

  // The ServerLink's events.
  void up() override IOTCLOUD_REQUIRES(mutex_);
  void down() override IOTCLOUD_REQUIRES(mutex_);
  void work() override IOTCLOUD_REQUIRES(mutex_);
  void report() override IOTCLOUD_REQUIRES(mutex_);
  std::size_t under_way() const override IOTCLOUD_REQUIRES(mutex_);
  void blame(const std::string& why) override IOTCLOUD_REQUIRES(mutex_);
  void on_outcome(pn_delivery_t* delivery, std::uint64_t outcome) override IOTCLOUD_REQUIRES(mutex_);
  void on_message(pn_delivery_t* delivery, const WireBytes& message) override IOTCLOUD_REQUIRES(mutex_);

  void send_waiting() IOTCLOUD_REQUIRES(mutex_);
  void find_route(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex_);
  void on_route(const std::shared_ptr<Outbox>& outbox, const std::vector<QueueFacts>& queues) IOTCLOUD_REQUIRES(mutex_);
  bool route_is_old(const RoutedOutbox& outbox) const;
  /// Checks, for a message that the server has just accepted, whether an earlier one of its publisher is still
  /// unanswered; logs and counts that.
  void check_order(const UnderWay& accepted) IOTCLOUD_REQUIRES(mutex_);

  Meters& meters_;
  /// The encoded head of the message being sent; a member, so that its memory is reused.
  std::string head_ IOTCLOUD_GUARDED_BY(mutex_);
  pn_link_t* readers_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;  ///< receives the advisories about readers
  bool blocked_ IOTCLOUD_GUARDED_BY(mutex_) = false;          ///< the server gives no credit
  bool said_overtook_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

}  // namespace iotcloud::brokers::activemq
