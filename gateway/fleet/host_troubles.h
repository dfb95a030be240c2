#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/losing_channel.h>

namespace iotcloud::gateway {

/// The instances of a gateway's driver host processes that hang or lose messages, as the hosts told last. Thread safe.
class HostTroubles {
 public:
  /// A callback may run for so long before its instance counts as hanging.
  static constexpr std::chrono::milliseconds grace{2'000};
  static constexpr std::size_t most = 20;           ///< instances that trouble() names
  static constexpr std::size_t longest_text = 100;  ///< of what a host tells

  /// \param host names the host: the name of its socket
  void put(const std::string& host, const std::vector<Stall>& stalls, const std::vector<LosingChannel>& losing,
           std::int64_t wall_ms);
  /// The host has ended.
  void forget(const std::string& host);
  /// For people: "instance ID hangs: ..." and "instance ID drops messages: ...", with "; " between; empty: none does.
  /// The text stays the same as long as nothing changes.
  std::string trouble() const;

 private:
  struct Told {
    std::map<discovery::InstanceId, std::int64_t> hanging;  ///< since when, wall time
    std::vector<LosingChannel> losing;
  };
  mutable config::Mutex mutex_;
  std::map<std::string, Told> hosts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
