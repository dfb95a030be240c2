#pragma once

#include <chrono>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {

/// Collects the states that a host reports, and waits for one. Thread safe.
class StatusLog {
 public:
  void add(const InstanceStatus& status) {
    {
      const std::lock_guard lock(mutex_);
      all_.push_back(status);
    }
    changed_.notify_all();
  }

  /// \return the instance's first status with that state since the last call for that instance; nullopt if none comes
  /// in time.
  std::optional<InstanceStatus> wait_for(const std::string& instance, discovery::DriverState state) {
    std::unique_lock lock(mutex_);
    std::optional<InstanceStatus> found;
    changed_.wait_for(lock, tests::patience, [&] {
      for (std::size_t& i = seen_[instance]; i < all_.size();) {
        const auto& status = all_[i++];
        if (status.instance != instance || status.state != state) continue;
        found = status;
        return true;
      }
      return false;
    });
    return found;
  }

  /// \return why its host was killed, or died, as the record says when it runs again. That it was `starting` between is
  /// seen by those only who look in time.
  std::string why_it_runs_again(const std::string& instance) {
    while (const auto again = wait_for(instance, discovery::DriverState::active)) {
      if (again->reason.starts_with("again, after its driver host ")) return again->reason;
    }
    return "it does not run again";
  }

  std::vector<discovery::DriverState> states(const std::string& instance) const {
    const std::lock_guard lock(mutex_);
    std::vector<discovery::DriverState> states;
    for (const auto& status : all_) {
      if (status.instance == instance) states.push_back(status.state);
    }
    return states;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<InstanceStatus> all_;          ///< guarded by mutex_
  std::map<std::string, std::size_t> seen_;  ///< by instance; guarded by mutex_
};

}  // namespace iotcloud::gateway
