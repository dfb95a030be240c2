#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/gateway/host/channel_tally.h>
#include <iotcloud/gateway/host/losing_channel.h>

namespace iotcloud::gateway {

/// Finds the channels that lose messages now, from what their tallies have counted at each look. Not thread safe.
class Losses {
 public:
  static constexpr std::chrono::seconds quiet{10};  ///< a channel that has lost nothing for so long is well again
  static constexpr std::size_t most = 20;           ///< channels that are named

  explicit Losses(const config::Clock& clock) : clock_(clock) {}

  /// Begins a look.
  void begin() { seen_.clear(); }
  /// A channel, as it is now.
  void see(const discovery::InstanceId& instance, const std::string& channel, const ChannelTally::Losses& losses);
  /// Ends the look. \return the channels that lose messages
  std::vector<LosingChannel> end();

 private:
  using Key = std::pair<discovery::InstanceId, std::string>;
  struct Known {
    std::int64_t lost = 0;
    config::Clock::Instant last{};  ///< the look at which it had grown
    std::int64_t since_ms = 0;      ///< 0: it loses nothing
    std::string fate{};
  };

  const config::Clock& clock_;
  std::map<Key, Known> known_, seen_;
};

}  // namespace iotcloud::gateway
