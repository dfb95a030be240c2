#include <algorithm>

#include <iotcloud/processes/restarts.h>

namespace iotcloud::processes {

std::chrono::milliseconds next_pause(std::chrono::milliseconds last, const RestartPolicy& policy) {
  return last.count() == 0 ? policy.first : std::min(last * 2, policy.longest);
}

std::optional<std::chrono::milliseconds> Restarts::failed(Instant now, const RestartPolicy& policy) {
  if (now - started_ >= policy.healthy_after) {
    failures_ = 0;
    pause_ = std::chrono::milliseconds{0};
  }
  ++failures_;
  if (policy.give_up_after > 0 && failures_ >= policy.give_up_after) return std::nullopt;
  pause_ = next_pause(pause_, policy);
  return pause_;
}

}  // namespace iotcloud::processes
