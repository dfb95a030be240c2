// What stands beside a group's committed offset, which any member of the group may write: eight bytes of the offset,
// and the text. The bits of the first byte say which of the records that come next are settled.
#include <algorithm>
#include <cstring>
#include <set>
#include <string>

#include "iotcloud/brokers/kafka/reading/progress.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
using brokers::kafka::Committed;
using brokers::kafka::Progress;

namespace {

constexpr std::int64_t records_to_come = 8;
constexpr std::size_t longest_text = 4096;                // that a server takes
constexpr std::int64_t farthest = std::int64_t{1} << 59;  // no partition has so many records

/// Whether the next reader finds what this one leaves.
void hand_over(Progress& progress, std::int64_t first, const std::set<std::int64_t>& settled, bool ends) {
  const auto left = progress.to_commit(ends);
  fuzz::must(left.has_value(), "a reader that has got records commits its place");
  fuzz::must(left->metadata.size() <= longest_text, "a server takes the text");
  Progress next(*left, 0);
  for (std::int64_t offset = first; offset < first + records_to_come; ++offset) {
    const bool done = settled.contains(offset);
    fuzz::must(offset < next.start() ? done : next.was_settled(offset) == done, "settled records stay settled");
    fuzz::must(done || next.maybe_handed_on(offset, first + records_to_come),
               "a record that was handed on is known as such");
  }
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(kafka_progress, 20'000) {
  Committed committed;
  if (size < 1 + sizeof committed.offset) return;
  std::memcpy(&committed.offset, data + 1, sizeof committed.offset);
  committed.metadata = fuzz::text(data + 1 + sizeof committed.offset, size - 1 - sizeof committed.offset);
  Progress progress(committed, 0);
  const std::int64_t first = std::max<std::int64_t>(progress.start(), 0);
  if (first > farthest) return;
  std::set<std::int64_t> settled;
  for (std::int64_t offset = first; offset < first + records_to_come; ++offset) {
    if (progress.was_settled(offset)) {
      progress.skipped(offset);
      settled.insert(offset);
      continue;
    }
    brokers::Message message;
    message.payload = brokers::Payload::copy(std::to_string(offset));
    progress.arrived(offset, std::move(message), progress.maybe_handed_on(offset, first + records_to_come));
  }
  for (unsigned bits = *data; progress.waiting() > 0; bits >>= 1U) {
    const auto arrived = progress.next();
    if ((bits & 1U) == 0) continue;
    progress.settle(arrived.tag, brokers::Settlement::accept);
    settled.insert(std::stoll(std::string(arrived.message.payload.text())));
  }
  hand_over(progress, first, settled, (*data & 0x80U) != 0);
}
