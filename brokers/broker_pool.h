#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

/// Where a channel's messages are: its logical broker, and that broker's servers, the preferred one first.
struct BrokerAddress {
  std::string broker;
  std::vector<std::string> urls;
  // NOLINTNEXTLINE(modernize-use-nullptr): clang-tidy 14 sees a comparison with 0 there.
  friend auto operator<=>(const BrokerAddress&, const BrokerAddress&) = default;
};

/// One Broker object for each address, shared by all who use it and closed when nobody does any more. Thread safe.
class BrokerPool {
 public:
  /// Both may be null, see BrokerOptions.
  BrokerPool(const config::Clock* clock, config::Metrics* metrics) : clock_(clock), metrics_(metrics) {}
  /// \param how to connect when there is no such object yet: the options without URLs, clock and metrics.
  /// \throws config::Error for URLs that name no broker.
  std::shared_ptr<Broker> get(const BrokerAddress& address, const BrokerOptions& how);

 private:
  const config::Clock* clock_;
  config::Metrics* metrics_;
  std::mutex mutex_;
  std::map<BrokerAddress, std::weak_ptr<Broker>> brokers_;  ///< guarded by mutex_
};

}  // namespace iotcloud::brokers
