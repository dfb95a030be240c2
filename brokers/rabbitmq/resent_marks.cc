#include "iotcloud/brokers/rabbitmq/resent_marks.h"

#include <algorithm>
#include <iterator>

namespace iotcloud::brokers::rabbitmq {
namespace {

/// Limit on the publishers remembered, far more than have messages under way when a server fails. Beyond it any other
/// publisher is forgotten.
constexpr std::size_t most_publishers = 4096;

}  // namespace

bool ResentMarks::may_be_a_copy(const std::optional<MessageOrigin>& origin, bool marked) {
  if (!origin) return marked;
  if (!marked) {
    const auto found = last_marked_.find(origin->publisher);
    return found != last_marked_.end() && origin->number <= found->second;
  }
  std::uint64_t& last = last_marked_[origin->publisher];
  last = std::max(last, origin->number);
  if (last_marked_.size() > most_publishers) {
    const auto first = last_marked_.begin();
    last_marked_.erase(first->first == origin->publisher ? std::next(first) : first);
  }
  return true;
}

}  // namespace iotcloud::brokers::rabbitmq
