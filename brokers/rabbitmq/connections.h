#pragma once

#include <memory>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_probe.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/consuming/read_connection.h"
#include "iotcloud/brokers/rabbitmq/publishing/publish_channel.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

/// The connections of one broker object, and their *keeper*, a thread that looks after them (a connection's own thread
/// may be stuck in a handler or a send). Publishing and consuming use separate connections, and so do urgent and other
/// channels; the connections for urgent channels are made with the first urgent channel. When a consuming connection
/// has as many subscriptions as the server allows channels, another one is made. Thread safe.
class Connections {
 public:
  /// All arguments outlive this object.
  Connections(const Cluster& cluster, Meters& meters, const config::Clock& clock);
  ~Connections();
  Connections(const Connections&) = delete;
  Connections& operator=(const Connections&) = delete;

  /// The publishing channel for messages of this priority; lives as long as this object.
  PublishChannel& publishing(std::uint8_t priority);
  std::shared_ptr<QueueReader> subscribe(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  std::string problem() const { return log_.problem(); }  ///< Broker::problem()
  ConnectionState state() const;
  /// Ends all reading for good; no handler runs when it has returned. Not to be called from a handler.
  void stop_reading();

 private:
  using ReadConnections = std::vector<std::shared_ptr<ReadConnection>>;

  /// A copy of the connections, so that the keeper can look after them without the mutex.
  struct Links {
    std::vector<PublishChannel*> publishing;
    ReadConnections consuming;
    ReadConnections urgent;
  };

  void keep();
  void look_after(const Links& links) IOTCLOUD_EXCLUDES(mutex_);
  void ask_preferred(const Links& links);
  Links links() const IOTCLOUD_REQUIRES(mutex_);
  ReadConnections& links_for(std::uint8_t priority) IOTCLOUD_REQUIRES(mutex_) {
    return priority >= urgent_priority ? urgent_ : consuming_;
  }
  std::shared_ptr<ReadConnection> with_room(std::uint8_t priority) IOTCLOUD_REQUIRES(mutex_);

  const Cluster& cluster_;
  Meters& meters_;
  const config::Clock& clock_;
  client::ConnectionLog log_;
  client::ServerProbe probe_;  ///< used by the keeper; asks the preferred server

  mutable config::Mutex mutex_;
  config::ConditionVariable stop_;
  // Connections are never removed from these.
  /// [0] for normal messages, [1] for urgent ones.
  std::vector<std::unique_ptr<PublishChannel>> publishing_ IOTCLOUD_GUARDED_BY(mutex_);
  ReadConnections consuming_ IOTCLOUD_GUARDED_BY(mutex_);
  ReadConnections urgent_ IOTCLOUD_GUARDED_BY(mutex_);
  bool stopping_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread keeper_;
};

}  // namespace iotcloud::brokers::rabbitmq
