#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <string_view>
#include <unordered_map>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::topology {

/// The instances of a driver that the registry has told of: on which gateway each is, and whether `where` chooses it.
/// The tasks of one spout component and their SpoutPlacement share it. Thread safe.
class KnownInstances {
 public:
  /// What an instance is for the reader of a channel on one gateway.
  enum class Standing {
    unknown,    ///< the registry has not told of it
    elsewhere,  ///< it is on another gateway
    unchosen,   ///< it is on this gateway, and `where` does not choose it
    chosen,
  };

  /// \param registry_tells whether the registry can be heard now; called on any thread. Empty: always.
  explicit KnownInstances(std::function<bool()> registry_tells = {}) : registry_tells_(std::move(registry_tells)) {}

  /// The registry tells what the instance's record says now. \param gateway empty: the record does not say
  void told(const discovery::InstanceId& instance, const discovery::GatewayId& gateway, bool chosen);
  /// The instance's record is gone. What was told last is kept for messages that it sent before.
  void gone(const discovery::InstanceId& instance);
  /// \param instance its id, as messages say it
  Standing of(std::string_view instance, const discovery::GatewayId& gateway) const;
  /// Whether `where` chose the instance last; true if the registry has not told of it.
  bool may_be_chosen(const discovery::InstanceId& instance) const;
  /// How many instances the registry has told of for the first time. While this grows, more may follow.
  std::uint64_t news() const { return news_.load(std::memory_order_relaxed); }
  /// Whether the registry can be heard now. While it cannot, an instance that is unknown may be there all the same.
  bool registry_tells() const { return !registry_tells_ || registry_tells_(); }

  /// How many instances that are gone are remembered.
  static constexpr std::size_t most_departed = 10'000;

 private:
  struct Known {
    discovery::GatewayId gateway;
    bool chosen = false;
    bool departed = false;
  };
  const std::function<bool()> registry_tells_;
  mutable config::SharedMutex mutex_;
  std::unordered_map<discovery::InstanceId, Known, std::hash<discovery::InstanceId>, std::equal_to<>> known_
      IOTCLOUD_GUARDED_BY(mutex_);
  std::deque<discovery::InstanceId> departed_ IOTCLOUD_GUARDED_BY(mutex_);  ///< oldest first; some may be back again
  std::atomic<std::uint64_t> news_{0};
};

}  // namespace iotcloud::topology
