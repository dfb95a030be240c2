#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "iotcloud/brokers/activemq/server_link.h"
#include "iotcloud/brokers/activemq/session_reader.h"
#include "iotcloud/brokers/client/read_core.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::activemq {

using client::ReadCore;

/// A base class, so that the core is constructed before the ServerLink, which the core's mutex guards.
struct ReceiverCore {
  ReceiverCore(client::ReadTransport& transport, Meters& meters, const config::Clock& clock)
      : core_(transport, meters, clock, std::chrono::milliseconds(0)) {}
  ReadCore core_;
};

/// The consuming connection of one broker object: the transport of a ReadCore. The loop's serving thread also runs the
/// handlers; when one runs long, the other thread reads on.
///
/// Each subscription has a session of its own: when a session ends, the server marks the messages that were delivered
/// on it and not settled as redelivered, which it does not do when only a link ends. The server gives an exclusive
/// queue to the first reader that opens it, but does not tell the others that they get nothing. So an exclusive reader
/// opens its link, then asks how many readers the queue has; if it is not alone, it leaves, and opens it again only
/// when the queue has no reader. It waits that long because of the order of messages: when a reader leaves a queue that
/// has another reader, the server may put the messages of the one that left behind messages that earlier readers had
/// left.
class ReceiverLink final : client::ReadTransport,
                           ReceiverCore,
                           public ServerLink,
                           public std::enable_shared_from_this<ReceiverLink> {
 public:
  ReceiverLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls, std::string purpose,
               Meters& meters, ConnectionLog& log, ServerTrust& trust);
  /// Waits for the running handler and closes the connection. Not to be called from a handler.
  void end();

  /// Adds a subscription. The first one starts the connection.
  std::shared_ptr<SessionReader> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler has returned, unless called from it.
  void remove(const std::shared_ptr<SessionReader>& reader);
  void pause(SessionReader& reader);
  void resume(SessionReader& reader);
  bool raise_prefetch(SessionReader& reader, std::uint16_t prefetch);
  bool active(const SessionReader& reader) const;
  void settle(SessionReader& reader, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection

  bool has_handlers_to_run() override;
  void run_handlers() override;

 private:
  using SessionReaders = std::vector<std::shared_ptr<SessionReader>>;

  /// Tells the thread safety analysis that the core's mutex, which is the link's, is held.
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(core_.mutex) {}

  // The ReadTransport.
  void settled(client::DeliveryStream& stream, bool first) noexcept override IOTCLOUD_REQUIRES(mutex_);
  void wake() noexcept override IOTCLOUD_REQUIRES(mutex_) { ServerLink::wake(); }

  // The ServerLink's events.
  void up() override IOTCLOUD_REQUIRES(mutex_);
  void down() override IOTCLOUD_REQUIRES(mutex_);
  void work() override IOTCLOUD_REQUIRES(mutex_);
  void before_flush() override IOTCLOUD_REQUIRES(mutex_) { send_all_settlements(); }
  void say_goodbye() override IOTCLOUD_REQUIRES(mutex_) { send_all_settlements(); }
  void on_receiver_open(pn_link_t* receiver) override IOTCLOUD_REQUIRES(mutex_);
  void on_receiver_closed(pn_link_t* receiver, const std::string& why) override IOTCLOUD_REQUIRES(mutex_);
  void on_session_open(pn_session_t* session) override IOTCLOUD_REQUIRES(mutex_);
  void on_session_closed(pn_session_t* session, const std::string& why) override IOTCLOUD_REQUIRES(mutex_);
  void on_message(pn_delivery_t* delivery, const WireBytes& message) override IOTCLOUD_REQUIRES(mutex_);
  void open_due() IOTCLOUD_REQUIRES(mutex_);
  void ask_for_places() IOTCLOUD_REQUIRES(mutex_);
  void ask_first(const std::shared_ptr<SessionReader>& reader) IOTCLOUD_REQUIRES(mutex_);
  void open(const std::shared_ptr<SessionReader>& reader) IOTCLOUD_REQUIRES(mutex_);
  void on_place(const std::shared_ptr<SessionReader>& reader, std::uint64_t generation, const QueueFacts& facts)
      IOTCLOUD_REQUIRES(mutex_);
  void activate(SessionReader& reader) IOTCLOUD_REQUIRES(mutex_);
  void refused(SessionReader* reader, const std::string& why) IOTCLOUD_REQUIRES(mutex_);
  void leave(SessionReader& reader) IOTCLOUD_REQUIRES(mutex_);
  void forget_session(SessionReader& reader) IOTCLOUD_REQUIRES(mutex_);
  void retry_later(SessionReader& reader) IOTCLOUD_REQUIRES(mutex_);
  void try_at(SessionReader& reader, Instant when) IOTCLOUD_REQUIRES(mutex_);
  void give_credit(SessionReader& reader, std::uint32_t count) IOTCLOUD_REQUIRES(mutex_);
  void send_settlements(SessionReader& reader) IOTCLOUD_REQUIRES(mutex_);
  void send_all_settlements() IOTCLOUD_REQUIRES(mutex_);

  Meters& meters_;

  std::uint64_t last_name_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  SessionReaders readers_ IOTCLOUD_GUARDED_BY(mutex_);
  SessionReaders leaving_ IOTCLOUD_GUARDED_BY(mutex_);  ///< removed subscriptions whose sessions are still open
  SessionReaders to_ask_
      IOTCLOUD_GUARDED_BY(mutex_);  ///< readers whose queues' number of readers is to be asked, in one question
  std::size_t opening_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< how many subscriptions wait for the server's answer
  /// No subscription has anything to do before this time.
  Instant next_try_ IOTCLOUD_GUARDED_BY(mutex_) = Instant::max();
};

}  // namespace iotcloud::brokers::activemq
