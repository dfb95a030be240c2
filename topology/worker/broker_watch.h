#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::topology {

/// Watches whether a worker's brokers can be reached, for its pages, /healthz and metrics. Thread safe.
class BrokerWatch {
 public:
  /// A broker that the worker uses.
  struct Link {
    std::string broker;  ///< its logical name
    std::string url;     ///< printable, of the preferred server
    brokers::ConnectionState state = brokers::ConnectionState::connecting;
    std::int64_t since_ms = 0;       ///< wall time of the first look that found it in this state
    std::string why{};               ///< Broker::problem()
    config::Clock::Instant since{};  ///< the same moment by the steady clock
    friend bool operator==(const Link&, const Link&) = default;
  };
  /// Lists the brokers, without `since_ms` and `since`. Called on the threads that look.
  using List = std::function<std::vector<Link>()>;
  /// A broker may be connecting for so long before it counts as trouble.
  static constexpr std::chrono::milliseconds grace{1000};

  /// \param labels of the metrics. Clock and metrics outlive the watch.
  BrokerWatch(List list, const config::Clock& clock, config::Metrics& metrics, config::Labels labels)
      : list_(std::move(list)), clock_(clock), metrics_(metrics), labels_(std::move(labels)) {}

  /// Looks again, and sets the metrics. Call it twice a second or so: that is how exact `since` is.
  std::vector<Link> look();
  /// Which brokers cannot be reached, or take nothing, since when and why; empty: all is well. Looks again. The text
  /// stays the same as long as nothing changes.
  std::string trouble();

 private:
  const List list_;
  const config::Clock& clock_;
  config::Metrics& metrics_;
  const config::Labels labels_;
  config::Mutex mutex_;
  std::map<std::pair<std::string, std::string>, Link> seen_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Lists the brokers of a pool.
BrokerWatch::List links_of(std::shared_ptr<brokers::BrokerPool> pool);

}  // namespace iotcloud::topology
