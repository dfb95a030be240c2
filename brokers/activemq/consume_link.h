#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/activemq/inlet.h"
#include "iotcloud/brokers/activemq/server_link.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::activemq {

/// The consuming connection of one broker object, with the thread that runs the handlers; the I/O thread reads on while
/// a handler runs long.
///
/// Each subscription has a session of its own: when a session ends, the server marks all that was delivered on it and
/// not settled as redelivered, which it does not when only a link ends.
/// The server gives an exclusive reader's place to the first one that asks, but does not tell the others. So a reader
/// asks for the place, then how many readers the queue has; one that is not alone leaves and comes again later.
class ConsumeLink final : public ServerLink, public std::enable_shared_from_this<ConsumeLink> {
 public:
  ConsumeLink(proton::container& container, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
              std::string purpose, Meters& meters, ConnectionLog& log);
  /// Closes the connection and ends the thread, if there is one. Not from a handler.
  void end();

  /// The first one starts the thread and connects.
  std::shared_ptr<Inlet> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler does not run any more, unless called from it.
  void remove(const std::shared_ptr<Inlet>& inlet);
  void pause(Inlet& inlet);
  void resume(const std::shared_ptr<Inlet>& inlet);
  bool active(const Inlet& inlet) const;
  void settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection

 private:
  using Inlets = std::vector<std::shared_ptr<Inlet>>;

  // On the I/O thread.
  void up() override;
  void down() override;
  void serve() override;
  void say_goodbye() override;
  void on_other_receiver_open(proton::receiver& receiver) override;
  void on_other_receiver_error(proton::receiver& receiver) override;
  void on_other_session_error(proton::session& session) override;
  void on_other_message(proton::delivery& delivery, proton::message& message) override;
  void open(const std::shared_ptr<Inlet>& inlet);
  void on_place(const std::shared_ptr<Inlet>& inlet, std::uint64_t generation, const std::vector<QueueFacts>& queues);
  void refused(const std::shared_ptr<Inlet>& inlet, const std::string& why);
  void leave(Inlet& inlet);
  void forget_session(Inlet& inlet);
  void retry_later(Inlet& inlet);
  void send_settlements(Inlet& inlet);
  void send_all_settlements();
  std::shared_ptr<Inlet> find(const proton::receiver& receiver) const;

  // On the handlers' thread.
  void run();
  void hand_on(Lock& lock, const std::shared_ptr<Inlet>& inlet);
  void run_handler(const Inlet& inlet, client::Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag);

  void make_ready(const std::shared_ptr<Inlet>& inlet);
  void make_dirty(const std::shared_ptr<Inlet>& inlet);

  Meters& meters_;
  std::map<std::string, std::shared_ptr<Inlet>, std::less<>> open_;  ///< by link name; the I/O thread's

  // Guarded by mutex_.
  std::condition_variable work_;
  std::condition_variable handler_ended_;
  bool ending_ = false;
  std::uint64_t last_name_ = 0;
  Inlets inlets_;
  Inlets leaving_;  ///< removed, session still open
  Inlets dirty_;
  std::deque<std::shared_ptr<Inlet>> ready_;
  std::thread thread_;
};

}  // namespace iotcloud::brokers::activemq
