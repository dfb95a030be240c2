#include <algorithm>

#include <iotcloud/recording/player.h>

namespace iotcloud::recording {

Played play(RecordingReader& recording, double speed, const std::function<bool(const RecordedMessage&)>& chosen,
            const std::function<void(RecordedMessage)>& hand, const std::stop_token& stop) {
  Played played;
  std::mutex mutex;
  std::condition_variable_any stopped;
  std::optional<Pace> pace;
  while (!stop.stop_requested()) {
    auto next = recording.next();
    if (!next) break;
    if (!chosen(*next)) continue;
    if (!pace) pace.emplace(next->at, Pace::Clock::now(), speed);
    const auto due = pace->due(next->at);
    {
      std::unique_lock lock(mutex);
      stopped.wait_until(lock, stop, due, [] { return false; });
    }
    if (stop.stop_requested()) break;
    hand(std::move(*next));
    ++played.messages;
    if (speed > 0) played.latest = std::max(played.latest, std::chrono::nanoseconds(Pace::Clock::now() - due));
  }
  return played;
}

}  // namespace iotcloud::recording
