#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::topology {

/// One Broker object for each URL, shared by all endpoints of a worker, closed when nobody uses it any more.
/// Thread safe.
class BrokerPool {
 public:
  BrokerPool(const config::Clock* clock, config::Metrics* metrics) : clock_(clock), metrics_(metrics) {}
  /// \throws config::Error for a URL that names no broker.
  std::shared_ptr<brokers::Broker> get(const std::string& url);

 private:
  const config::Clock* clock_;
  config::Metrics* metrics_;
  std::mutex mutex_;
  std::map<std::string, std::weak_ptr<brokers::Broker>> brokers_;  ///< guarded by mutex_
};

/// What the endpoints of a worker share. Filled by the worker before the topology starts, constant from then on.
struct EndpointServices {
  std::string topology;                     ///< name: the group that reads, and part of every election's path
  std::string worker;                       ///< this worker's name below Paths::workers(topology)
  discovery::Registry* registry = nullptr;  ///< outlives the topology's run
  discovery::Paths paths;
  std::map<std::string, std::string> broker_urls;  ///< by logical name: used instead of the channel's own URL
  std::shared_ptr<BrokerPool> brokers;
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  std::vector<std::function<void()>> before_stop;  ///< the worker calls them before it stops the topology
};
using EndpointServicesPtr = std::shared_ptr<EndpointServices>;

/// Where a channel's messages are: the topic, and the URL of its broker (`brokers` in the YAML goes before the record).
brokers::Topic topic_of(const discovery::ChannelRecord& channel);
std::string url_of(const discovery::ChannelRecord& channel, const EndpointServices& services);

}  // namespace iotcloud::topology
