#pragma once

#include <cstdint>
#include <map>
#include <optional>

#include "iotcloud/brokers/rabbitmq/wire/headers.h"

namespace iotcloud::brokers::rabbitmq {

/// Finds copies of messages that publishers sent again. A paused server that resumes still takes the messages in its
/// old connections: unmarked copies that arrive after the marked ones. A publisher sends its messages in order, so any
/// message with a lower number than a marked one is such a copy. Not thread safe.
class ResentMarks {
 public:
  /// Whether a message may have been read before. \param origin nullopt: another program published it. \param marked
  /// its publisher marked it as sent again.
  bool may_be_a_copy(const std::optional<MessageOrigin>& origin, bool marked);

 private:
  std::map<std::uint64_t, std::uint64_t> last_marked_;  ///< the number of the last marked message, by publisher
};

}  // namespace iotcloud::brokers::rabbitmq
