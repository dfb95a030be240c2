#include "iotcloud/brokers/spool/spool_meters.h"

namespace iotcloud::brokers::spool {

SpoolMeters::SpoolMeters(config::Metrics* metrics, const config::Labels& labels)
    : metrics_(metrics != nullptr ? *metrics : config::process_metrics()),
      labels_(labels),
      messages_(metrics_.gauge("iotcloud_spool_messages", "Unfinished messages in spools", labels)),
      bytes_(metrics_.gauge("iotcloud_spool_bytes", "Bytes that spools take on disk", labels)),
      restored_(metrics_.counter("iotcloud_spool_restored_total", "Messages that an earlier process left in the spool",
                                 labels)),
      damaged_bytes_(metrics_.counter("iotcloud_spool_damaged_bytes_total",
                                      "Bytes in spools that could not be read any more", labels)),
      torn_bytes_(metrics_.counter("iotcloud_spool_torn_bytes_total",
                                   "Bytes of records that were not complete when the process stopped", labels)),
      disk_failures_(metrics_.counter("iotcloud_spool_disk_failures_total",
                                      "Writes to spools that failed, because the disk is full or broken", labels)) {}

SpoolMeters::~SpoolMeters() {
  if (own_messages_ != 0 || own_bytes_ != 0) close();
}

void SpoolMeters::level(std::uint64_t messages, std::uint64_t bytes) {
  messages_.add(static_cast<std::int64_t>(messages - own_messages_));
  bytes_.add(static_cast<std::int64_t>(bytes - own_bytes_));
  own_messages_ = messages;
  own_bytes_ = bytes;
}

void SpoolMeters::dropped(const std::string& reason, std::uint64_t count) {
  config::Labels labels = labels_;
  labels["reason"] = reason;
  metrics_.counter("iotcloud_spool_dropped_total", "Messages that spools gave up, by reason", labels).add(count);
}

}  // namespace iotcloud::brokers::spool
