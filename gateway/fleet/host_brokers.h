#pragma once

#include <chrono>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/broker_states.h>

namespace iotcloud::gateway {

/// The brokers that a gateway's driver host processes use, as the hosts told last. Thread safe.
class HostBrokers {
 public:
  /// A broker may be connecting for so long before it counts as trouble.
  static constexpr std::chrono::milliseconds grace{300};

  /// \param host names the host: the name of its socket. \param now by the steady clock, as below
  void put(const std::string& host, std::vector<BrokerLink> links, config::Clock::Instant now);
  /// The host has ended.
  void forget(const std::string& host);
  /// Which brokers the hosts cannot reach, or which take no messages, since when and why, for people; empty: none. The
  /// text stays the same as long as nothing changes.
  std::string trouble(config::Clock::Instant now) const;

 private:
  struct Told {
    BrokerLink link;
    config::Clock::Instant since;  ///< when the host first told that the broker is in this state
  };
  mutable config::Mutex mutex_;
  std::map<std::string, std::vector<Told>> hosts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
