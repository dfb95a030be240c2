#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <optional>
#include <string_view>
#include <unordered_map>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::topology {

/// Which of a driver's instances `where` chooses, by the last news from the registry. The tasks of one spout component
/// and their SpoutPlacement share it. Thread safe.
class ChosenInstances {
 public:
  /// Takes news from the registry. \param chosen nullopt: the instance is gone; whether it was chosen last is kept for
  /// messages that it sent before.
  void told(const discovery::InstanceId& instance, std::optional<bool> chosen);
  /// Whether the instance is chosen; nullopt: the registry has not told of it. \param instance its id, as messages say
  /// it
  std::optional<bool> of(std::string_view instance) const;

  /// How many instances that are gone are remembered.
  static constexpr std::size_t most_departed = 10'000;

 private:
  struct Choice {
    bool chosen = false;
    bool departed = false;
  };
  mutable config::SharedMutex mutex_;
  std::unordered_map<discovery::InstanceId, Choice, std::hash<discovery::InstanceId>, std::equal_to<>> choices_
      IOTCLOUD_GUARDED_BY(mutex_);
  std::deque<discovery::InstanceId> departed_ IOTCLOUD_GUARDED_BY(mutex_);  ///< oldest first; some may be back again
};

}  // namespace iotcloud::topology
