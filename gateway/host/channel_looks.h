#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

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
  static constexpr std::chrono::seconds longest_wait{1};  ///< for a message's end, with every_ms

  explicit ChannelLooks(const config::Clock& clock) : clock_(clock) {}

  /// Whether saw() is to be told of messages.
  bool watched() const { return watched_.load(std::memory_order_relaxed); }
  /// When a message passed the host, by the host's clock.
  struct Passage {
    std::uint64_t key = 0;                         ///< names the message in ended(); 0: nobody will tell its end
    config::Clock::Instant begin{};                ///< its driver published it, or is about to be given it
    std::optional<config::Clock::Instant> came{};  ///< of an incoming message
  };
  /// The channel has carried a message.
  void saw(const brokers::Message& message, const Passage& passage);
  /// A message has come to its end, perhaps before saw() tells of it. \param fate as SeenMessage::fate
  void ended(std::uint64_t key, const std::string& fate);
  /// Writes into the answer what the look has seen since its last question. The first question begins it.
  void answer(const discovery::LookRequest& request, discovery::ChannelLook& answer);

 private:
  struct Look {
    config::Clock::Instant began, asked;
    std::optional<config::Clock::Instant> last;  ///< when the last message came
    std::int32_t most = 0, bytes = 0;
    std::int32_t every_ms = 0;
    std::optional<std::int64_t> slot{};  ///< of the message that was kept last, with every_ms
    std::size_t kept_bytes = 0;
    discovery::ChannelLook seen;
    std::vector<std::uint64_t> keys{};  ///< of the messages in `seen`
  };
  /// The end of a message.
  struct End {
    std::uint64_t key = 0;
    config::Clock::Instant at{};
    std::string fate;
  };
  static constexpr std::size_t most_ends = 64;
  bool keeps(Look& look, const brokers::Message& message) const;
  void take_told(Look& look, config::Clock::Instant now, discovery::ChannelLook& answer) const;
  static void note(discovery::SeenMessage& seen, const End& end);

  void end_silent_looks(config::Clock::Instant now) IOTCLOUD_REQUIRES(mutex_);

  const config::Clock& clock_;
  std::atomic<bool> watched_{false};
  config::Mutex mutex_;
  std::map<std::string, Look> looks_ IOTCLOUD_GUARDED_BY(mutex_);
  std::deque<End> ends_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the latest
};

}  // namespace iotcloud::gateway
