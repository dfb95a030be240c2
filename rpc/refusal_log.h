#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::rpc {

/// The log of what a server refuses. A flood of refused clients must not fill the disk: of each kind the first is
/// logged, and then one a minute with the number of those that were not. Metrics count all of them. Thread safe.
class RefusalLog {
 public:
  static constexpr std::chrono::minutes pause{1};

  explicit RefusalLog(config::Logger logger, const config::Clock& clock = config::system_clock())
      : logger_(logger), clock_(clock) {}

  /// \param kind what is counted together: one of few. \param text the line for this refusal
  void refused(const std::string& kind, const std::string& text) {
    const auto unsaid = due(kind);
    if (!unsaid) return;
    if (*unsaid == 0) {
      logger_.warn("{}", text);
    } else {
      logger_.warn("{}; and {} more of this kind since the last such line", text, *unsaid);
    }
  }

 private:
  struct Said {
    config::Clock::Instant at;
    std::uint64_t unsaid = 0;
  };

  /// \return nullopt: no line is due; otherwise how many refusals of this kind had none.
  std::optional<std::uint64_t> due(const std::string& kind) {
    const auto now = clock_.now();
    const config::MutexLock lock(mutex_);
    const auto [said, first] = said_.try_emplace(kind, Said{now, 0});
    if (!first && now - said->second.at < pause) {
      ++said->second.unsaid;
      return std::nullopt;
    }
    said->second.at = now;
    return std::exchange(said->second.unsaid, 0);
  }

  const config::Logger logger_;
  const config::Clock& clock_;
  config::Mutex mutex_;
  std::map<std::string, Said> said_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::rpc
