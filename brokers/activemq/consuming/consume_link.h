#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/activemq/connection/server_link.h"
#include "iotcloud/brokers/activemq/consuming/inlet.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::activemq {

/// The consuming connection of one broker object. The loop's thread that serves it also runs the handlers; when one
/// runs long the other thread reads on.
///
/// Each subscription has a session of its own: when a session ends, the server marks all that was delivered on it and
/// not settled as redelivered, which it does not when only a link ends.
/// The server gives an exclusive reader's place to the first one that asks, but does not tell the others. So a reader
/// asks for the place, then how many readers the queue has; one that is not alone leaves and comes again later.
class ConsumeLink final : public ServerLink, public std::enable_shared_from_this<ConsumeLink> {
 public:
  ConsumeLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls, std::string purpose,
              Meters& meters, ConnectionLog& log);
  /// Waits for the handler that runs and closes the connection. Not from a handler.
  void end();

  /// The first one connects.
  std::shared_ptr<Inlet> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler does not run any more, unless called from it.
  void remove(const std::shared_ptr<Inlet>& inlet);
  void pause(Inlet& inlet);
  void resume(const std::shared_ptr<Inlet>& inlet);
  bool active(const Inlet& inlet) const;
  void settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection

  bool has_handlers_to_run() override;
  void run_handlers() override;

 private:
  using Inlets = std::vector<std::shared_ptr<Inlet>>;

  // What the server says, and what is said to it: consume_link_wire.cc.
  void up() override;
  void down() override;
  void work() override;
  void before_flush() override { send_all_settlements(); }
  void say_goodbye() override { send_all_settlements(); }
  void on_receiver_open(pn_link_t* receiver) override;
  void on_receiver_closed(pn_link_t* receiver, const std::string& why) override;
  void on_session_closed(pn_session_t* session, const std::string& why) override;
  void on_message(pn_delivery_t* delivery, const WireBytes& message) override;
  void open_due();
  void ask_for_places();
  void open(const std::shared_ptr<Inlet>& inlet);
  void on_place(const std::shared_ptr<Inlet>& inlet, std::uint64_t generation, const QueueFacts& facts);
  void activate(Inlet& inlet);
  void refused(Inlet* inlet, const std::string& why);
  void leave(Inlet& inlet);
  void forget_session(Inlet& inlet);
  void retry_later(Inlet& inlet);
  void try_at(Inlet& inlet, Instant when);
  void give_credit(Inlet& inlet, std::uint32_t count);
  void send_settlements(Inlet& inlet);
  void send_all_settlements();

  void hand_on(Lock& lock, const std::shared_ptr<Inlet>& inlet);
  void run_handler(const Inlet& inlet, client::Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag);

  void make_ready(const std::shared_ptr<Inlet>& inlet);
  void make_dirty(const std::shared_ptr<Inlet>& inlet);

  Meters& meters_;

  // Guarded by mutex_.
  std::condition_variable handler_ended_;
  bool ending_ = false;
  std::uint64_t last_name_ = 0;
  Inlets inlets_;
  Inlets leaving_;  ///< removed, session still open
  Inlets dirty_;
  std::deque<std::shared_ptr<Inlet>> ready_;
  Inlets to_ask_;                      ///< open; how many readers their queues have is to be asked, for all together
  std::size_t opening_ = 0;            ///< so many wait for the server's answer
  Instant next_try_ = Instant::max();  ///< no subscription has something to do before that
  std::thread::id handler_thread_;     ///< runs handlers; none: nobody does
};

}  // namespace iotcloud::brokers::activemq
