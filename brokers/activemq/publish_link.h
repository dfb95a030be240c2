#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <proton/tracker.hpp>

#include "iotcloud/brokers/activemq/server_link.h"
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

/// The publishing connection of one broker object. Callers of publish() leave their messages here; the I/O thread sends
/// them, many for one wake-up. All go over one link, so that messages of a topic keep their order whatever way they
/// take.
class PublishLink final : public ServerLink {
 public:
  PublishLink(proton::container& container, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
              std::string purpose, Meters& meters, ConnectionLog& log);

  std::shared_ptr<Outlet> add(const Topic& topic, const PublisherOptions& options);
  /// Closes the publisher: reports what has no outcome as unknown, waits for callbacks that run.
  void remove(const std::shared_ptr<Outlet>& outlet);
  PublishStatus publish(const std::shared_ptr<Outlet>& outlet, Message message, const Past& past = {});
  bool drain(const std::shared_ptr<Outlet>& outlet, std::chrono::milliseconds limit);
  std::size_t pending(const Outlet& outlet) const;
  ConnectionState state() const;

 private:
  struct UnderWay {
    proton::tracker tracker;
    std::shared_ptr<Outlet> outlet;
    Outgoing outgoing;
    bool answered = false;
  };

  void up() override;
  void down() override;
  void serve() override;
  std::size_t under_way() const override;
  void blame(const std::string& why) override;
  void on_tracker_accept(proton::tracker& tracker) override;
  void on_tracker_reject(proton::tracker& tracker) override;
  void on_tracker_release(proton::tracker& tracker) override;
  void on_sendable(proton::sender& sender) override;
  void on_other_message(proton::delivery& delivery, proton::message& message) override;

  enum class Verdict { accepted, rejected, released };
  void on_verdict(const proton::tracker& tracker, Verdict verdict);
  void send_waiting(Lock& lock);
  void send(Lock& lock, const std::shared_ptr<Outlet>& outlet, Outgoing outgoing);
  void find_route(const std::shared_ptr<Outlet>& outlet);
  void on_route(const std::shared_ptr<Outlet>& outlet, const std::vector<QueueFacts>& queues);
  bool route_is_old(const Outlet& outlet) const;
  void make_runnable(const std::shared_ptr<Outlet>& outlet);
  void fire_timers();

  Meters& meters_;
  proton::receiver readers_;  ///< tells of readers that come and go

  // Guarded by mutex_.
  client::OutcomeReporter reporter_{changed_, meters_};
  bool blocked_ = false;  ///< the server gives no credit
  std::vector<std::shared_ptr<Outlet>> outlets_;
  std::deque<std::shared_ptr<Outlet>> runnable_;
  std::deque<UnderWay> under_way_;
  std::size_t one_by_one_ = 0;  ///< so many messages still go alone: one of them made the server close the connection
};

}  // namespace iotcloud::brokers::activemq
