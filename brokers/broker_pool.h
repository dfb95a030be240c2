#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers {

/// Where a channel's messages are: its logical broker, and that broker's servers in order of preference.
struct BrokerAddress {
  std::string broker;
  std::vector<std::string> urls;
  /// Moves the server that `url` names by host and port to the front; the others follow in their cyclic order. Scheme
  /// and credentials stay those of `urls`. A server that is not in `urls`, or a malformed URL, changes nothing.
  void prefer(const std::string& url);
  // NOLINTNEXTLINE(modernize-use-nullptr): clang-tidy 14 sees a comparison with 0 there.
  friend auto operator<=>(const BrokerAddress&, const BrokerAddress&) = default;
};

/// One Broker object for each address, shared by its users and closed when the last releases it. Thread safe.
class BrokerPool {
 public:
  /// Makes an empty pool. Clock and metrics may be null, see BrokerOptions.
  BrokerPool(const config::Clock* clock, config::Metrics* metrics) : clock_(clock), metrics_(metrics) {}
  /// \param how the options, without URLs, clock and metrics, for a new object.
  /// \throws config::Error for URLs that name no broker.
  std::shared_ptr<Broker> get(const BrokerAddress& address, const BrokerOptions& how);
  /// The addresses and brokers that somebody uses now.
  std::vector<std::pair<BrokerAddress, std::shared_ptr<Broker>>> in_use();

 private:
  const config::Clock* clock_;
  config::Metrics* metrics_;
  config::Mutex mutex_;
  std::map<BrokerAddress, std::weak_ptr<Broker>> brokers_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::brokers
