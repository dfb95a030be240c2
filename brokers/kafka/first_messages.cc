#include "iotcloud/brokers/kafka/first_messages.h"

#include <librdkafka/rdkafka.h>

namespace iotcloud::brokers::kafka {

void FirstMessages::begin_anew(int partitions) {
  unknown_ = static_cast<std::size_t>(partitions);
  partitions_.assign(unknown_, {});
  waits_until_ = {};
}

FirstMessages::Partition* FirstMessages::unknown(std::string_view key) {
  if (unknown_ == 0) return nullptr;
  // What the setting "partitioner" names.
  const std::int32_t number = rd_kafka_msg_partitioner_murmur2(
      nullptr, key.data(), key.size(), static_cast<std::int32_t>(partitions_.size()), nullptr, nullptr);
  Partition& partition = partitions_[static_cast<std::size_t>(number)];
  return partition.known ? nullptr : &partition;
}

bool FirstMessages::takes(std::string_view key, const config::Clock& clock) {
  const Partition* const partition = unknown(key);
  if (partition == nullptr || partition->first_at == Instant{}) return true;
  if (clock.now() >= partition->first_at + longest_wait) return true;
  waits_until_ = partition->first_at + longest_wait;
  return false;
}

void FirstMessages::sent(std::string_view key, const config::Clock& clock) {
  Partition* const partition = unknown(key);
  if (partition != nullptr && partition->first_at == Instant{}) partition->first_at = clock.now();
}

void FirstMessages::answered(std::string_view key, bool stored) {
  waits_until_ = {};
  Partition* const partition = unknown(key);
  if (partition == nullptr) return;
  if (stored) --unknown_;
  partition->known = stored;
  partition->first_at = {};
}

}  // namespace iotcloud::brokers::kafka
