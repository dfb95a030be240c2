#pragma once

#include <atomic>
#include <cstddef>
#include <map>
#include <optional>
#include <string>

#include <iotcloud/brokers/message.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/channel_look.h>

namespace iotcloud::gateway {

/// A person's request to a channel: to look at it or, with a message, to hand that to its instance.
struct ChannelQuestion {
  discovery::LookRequest look;
  std::optional<brokers::Message> message{};
};

/// The looks at one channel. A look counts the messages and keeps a sample of them until the next question; it ends
/// when nobody asks for `longest_silence`. While there is none, a message costs one read of `watched()`. Thread safe.
class ChannelLooks {
 public:
  static constexpr std::size_t most_looks = 8;  ///< at one channel
  static constexpr std::chrono::seconds longest_silence{10};

  explicit ChannelLooks(const config::Clock& clock) : clock_(clock) {}

  /// Whether saw() is to be told of messages.
  bool watched() const { return watched_.load(std::memory_order_relaxed); }
  /// The channel has carried a message.
  void saw(const brokers::Message& message);
  /// Writes into the answer what the look has seen since its last question. The first question begins it.
  void answer(const discovery::LookRequest& request, discovery::ChannelLook& answer);

 private:
  struct Look {
    config::Clock::Instant began, asked;
    std::optional<config::Clock::Instant> last;  ///< when the last message came
    std::int32_t most = 0, bytes = 0;
    std::size_t kept_bytes = 0;
    discovery::ChannelLook seen;
  };
  void end_silent_looks(config::Clock::Instant now) IOTCLOUD_REQUIRES(mutex_);

  const config::Clock& clock_;
  std::atomic<bool> watched_{false};
  config::Mutex mutex_;
  std::map<std::string, Look> looks_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
