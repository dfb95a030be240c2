#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <librdkafka/rdkafka.h>

#include "iotcloud/brokers/envelope.h"
#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers::kafka {

/// What a record says beside its message, in headers of its own whatever the form of the value.
struct RecordMarks {
  bool resent = false;          ///< given to a client before that was lost: possibly a duplicate
  std::int64_t expires_ms = 0;  ///< since 1970 UTC: to be dropped by the reader from then on. 0 = never
};

/// Gives the message to the library: as a TSensorMessage, or (`native`) as the bare body with the metadata in headers.
/// The key is the driver's id, so that all of one driver goes to one partition. Never blocks.
/// \param envelope what encode_envelope() made of it, unless `native`; lives, as does the message, until the report.
/// \param now_ms the wall clock; the record has the message's time when that is near to it, because servers delete
/// records by their age. \param opaque comes back with the report. \return why it was not taken.
rd_kafka_resp_err_t produce(rd_kafka_t* client, rd_kafka_topic_t* topic, const Message& message,
                            const RecordMarks& marks, bool native, std::int64_t now_ms, const EnvelopeBytes& envelope,
                            void* opaque);

struct ReadRecord {
  Message message;
  RecordMarks marks;
};

/// The message of a record, whoever wrote it. A record that has our header with the driver's id, and every one when
/// `native`, has a bare body; all others must be a TSensorMessage. A large body is not copied: it keeps the record.
/// \return nothing for what cannot be understood.
std::optional<ReadRecord> read_record(std::shared_ptr<const rd_kafka_message_t> record, bool native);

}  // namespace iotcloud::brokers::kafka
