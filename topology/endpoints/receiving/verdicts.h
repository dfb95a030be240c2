#pragma once

#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <unordered_map>

namespace iotcloud::topology {

/// Which of a driver's instances `where` chooses, as the registry told last; shared by the tasks of one spout component
/// and its placement. Thread safe.
class Verdicts {
 public:
  /// \param chosen nullopt: the instance is gone. What it sent before is still judged as it was last.
  void told(const std::string& instance, std::optional<bool> chosen);
  /// nullopt: the registry has not told of it.
  std::optional<bool> of(const std::string& instance) const;

  /// So many instances that went are remembered.
  static constexpr std::size_t most_departed = 10'000;

 private:
  struct Verdict {
    bool chosen = false;
    bool departed = false;
  };
  mutable std::shared_mutex mutex_;
  std::unordered_map<std::string, Verdict> verdicts_;  ///< by instance; guarded by mutex_
  std::deque<std::string> departed_;                   ///< oldest first, some back again; guarded by mutex_
};

}  // namespace iotcloud::topology
