#pragma once

#include <cstdint>
#include <map>
#include <optional>

#include "iotcloud/brokers/rabbitmq/wire/headers.h"

namespace iotcloud::brokers::rabbitmq {

/// What was read of messages that their publishers sent again. A server that was paused takes, when it goes on, what
/// still stands in the connections that were given up meanwhile: copies without a mark that come after the marked ones.
/// A publisher sends its messages in order, so whatever has a lower number than a marked one is such a copy.
/// Not thread safe.
class ResentMarks {
 public:
  /// Whether a message may have been read before. \param origin nullopt: another program published it. \param marked
  /// as sent again by its publisher
  bool may_be_a_copy(const std::optional<Origin>& origin, bool marked);

 private:
  std::map<std::uint64_t, std::uint64_t> last_marked_;  ///< its number, by publisher
};

}  // namespace iotcloud::brokers::rabbitmq
