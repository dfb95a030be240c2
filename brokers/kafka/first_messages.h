#pragma once

#include <chrono>
#include <cstdint>
#include <string_view>
#include <vector>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

/// Keeps the first message that a producer sends to a partition of a topic apart from its later ones.
///
/// A server takes any sequence number from a producer that it does not know in that partition. So it may refuse the
/// producer's first request ("not leader", when the topic was just made or its leader changes) and take the second one,
/// which is under way too. An idempotent producer of librdkafka concludes that the first one is stored as well, reports
/// it as delivered, and loses it (seen with 2.0.2; confluent-kafka-go issue 921, open). So of each partition the
/// library gets one message, and further ones when that one was confirmed. Later requests are safe: a server that knows
/// the producer refuses those that come too early.
///
/// Not thread safe.
class FirstMessages {
 public:
  using Instant = config::Clock::Instant;

  /// A partition holds its topic up for so long at most, because it may have no leader while others have one.
  static constexpr std::chrono::milliseconds longest_wait{1000};

  /// Forgets all partitions: nothing was sent to any of them.
  void begin_anew(int partitions);
  /// Whether a message with this key may go now. If not, see waits_until().
  bool takes(std::string_view key, const config::Clock& clock);
  /// The library gets a message with this key.
  void sent(std::string_view key, const config::Clock& clock);
  /// The library reported its outcome. \param stored the server has it
  void answered(std::string_view key, bool stored);
  /// While the message for which takes() said no waits for an answer: when it may go without one. Zero: none waits.
  Instant waits_until() const { return waits_until_; }

 private:
  struct Partition {
    bool known = false;  ///< the server has stored a message of this producer
    Instant first_at{};  ///< when its first message was sent; zero: none is under way
  };
  /// The partition to which the library sends messages with this key; null: it is known.
  Partition* unknown(std::string_view key);

  std::vector<Partition> partitions_;
  std::size_t unknown_ = 0;
  Instant waits_until_{};
};

}  // namespace iotcloud::brokers::kafka
