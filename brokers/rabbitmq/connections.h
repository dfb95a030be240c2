#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_probe.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/consuming/consume_link.h"
#include "iotcloud/brokers/rabbitmq/publishing/publish_link.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// The connections of one broker object, and the thread that looks after them (the keeper: a connection's own thread
/// may be stuck in a handler or a send). Publishing and consuming go separate ways, and so do urgent channels and
/// others: the urgent connections are made when the first urgent channel is. A consuming connection that has as many
/// subscriptions as the server allows channels is followed by another one. Thread safe.
class Connections {
 public:
  /// All outlive it.
  Connections(const Cluster& cluster, Meters& meters, const config::Clock& clock);
  ~Connections();
  Connections(const Connections&) = delete;
  Connections& operator=(const Connections&) = delete;

  /// For messages of this priority; lives as long as this object.
  PublishLink& publishing(std::uint8_t priority);
  std::shared_ptr<Inlet> subscribe(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  ConnectionState state() const;
  /// Ends all reading for good; no handler runs any more when it returns. Not from a handler.
  void stop_reading();

 private:
  using ConsumeLinks = std::vector<std::shared_ptr<ConsumeLink>>;

  void keep();
  void look_after();
  void ask_preferred(std::unique_lock<std::mutex>& lock);
  ConsumeLinks& links_for(std::uint8_t priority) { return priority >= urgent_priority ? urgent_ : consuming_; }
  ConsumeLink& roomy(ConsumeLinks& links);

  const Cluster& cluster_;
  Meters& meters_;
  const config::Clock& clock_;
  client::ConnectionLog log_;
  client::ServerProbe probe_;  ///< the keeper's; of the preferred server

  mutable std::mutex mutex_;
  std::condition_variable stop_;
  // All below: guarded by mutex_. Links are never taken out.
  std::vector<std::unique_ptr<PublishLink>> publishing_;  ///< [0] for all, [1] for urgent messages
  ConsumeLinks consuming_;
  ConsumeLinks urgent_;
  bool stopping_ = false;
  std::thread keeper_;
};

}  // namespace iotcloud::brokers::rabbitmq
