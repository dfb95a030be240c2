#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/activemq/connection/server_link.h"
#include "iotcloud/brokers/client/outbox_timers.h"
#include "iotcloud/brokers/client/outcome_reporter.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::activemq {

using client::Outbox;
using client::Outgoing;

/// A publisher's messages and the way they take.
class Outlet final : public Outbox {
 public:
  Outlet(const Topic& to, const PublisherOptions& how);
  /// Which queues there are is asked before the first message, and again from time to time: the server takes messages
  /// for a topic that no queue stands for, and loses them.
  enum class Route { unknown, asked, known };
  const std::string own_queue;
  Route route = Route::unknown;
  std::string address;  ///< when the route is known
  bool own_queue_exists = false;
  Instant asked_at{};
};

/// The publishing connection of one broker object. Callers of publish() send on their own thread, as far as the socket
/// takes it; the loop does the rest. All messages go over one AMQP link, so that those of a topic keep their order
/// whatever way they take.
class PublishLink final : public ServerLink {
 public:
  PublishLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls, std::string purpose,
              Meters& meters, ConnectionLog& log);

  std::shared_ptr<Outlet> add(const Topic& topic, const PublisherOptions& options);
  /// Closes the publisher: reports what has no outcome as unknown, waits for callbacks that run.
  void remove(const std::shared_ptr<Outlet>& outlet);
  PublishStatus publish(const std::shared_ptr<Outlet>& outlet, Message message, const Past& past = {});
  bool drain(const std::shared_ptr<Outlet>& outlet, std::chrono::milliseconds limit);
  std::size_t pending(const Outlet& outlet) const;
  ConnectionState state() const;

 private:
  struct UnderWay {
    std::shared_ptr<Outlet> outlet;
    Outgoing outgoing;
    bool answered = false;
  };

  void up() override;
  void down() override;
  void work() override;
  void report(Lock& lock) override;
  std::size_t under_way() const override { return under_way_.size(); }
  void blame(const std::string& why) override;
  void on_outcome(pn_delivery_t* delivery, std::uint64_t outcome) override;
  void on_message(pn_delivery_t* delivery, const WireBytes& message) override;

  void send_waiting();
  void send(const std::shared_ptr<Outlet>& outlet, Outgoing outgoing);
  void send_now();
  void find_route(const std::shared_ptr<Outlet>& outlet);
  void on_route(const std::shared_ptr<Outlet>& outlet, const std::vector<QueueFacts>& queues);
  /// Of a message that was just accepted: whether an earlier one of its topic was not.
  void check_order(const UnderWay& accepted);
  bool route_is_old(const Outlet& outlet) const;
  void make_runnable(const std::shared_ptr<Outlet>& outlet);
  void note(const std::shared_ptr<Outlet>& outlet);
  void fire_timers();

  Meters& meters_;
  std::string head_;              ///< of the message that is being sent: the buffer is used again
  pn_link_t* readers_ = nullptr;  ///< tells of readers that come and go
  client::OutcomeReporter reporter_{changed_, meters_};
  bool blocked_ = false;  ///< the server gives no credit
  client::OutboxTimers timers_;
  std::vector<std::shared_ptr<Outlet>> outlets_;
  std::deque<std::shared_ptr<Outlet>> runnable_;
  std::deque<UnderWay> under_way_;  ///< entries stay where they are: their deliveries refer to them
  bool said_overtook_ = false;
  std::size_t one_by_one_ = 0;  ///< so many messages still go alone: one of them made the server close the connection
  std::thread::id reporting_;   ///< calls callbacks
};

}  // namespace iotcloud::brokers::activemq
