#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <librdkafka/rdkafka.h>

#include "iotcloud/brokers/envelope.h"
#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers::kafka {

/// Metadata of a record in headers of its own, whatever the form of its value.
struct RecordMarks {
  bool resent = false;          ///< an earlier, lost client had it: possibly a duplicate
  std::int64_t expires_ms = 0;  ///< since 1970 UTC: the reader drops the record after this time. 0 = never
};

/// The contents of a record's headers.
struct RecordHeaders {
  Message message;  ///< the metadata of a record with a bare body; without the body
  std::optional<std::int64_t> time_ms;
  bool bare_body = false;  ///< the record's value is the body alone
  RecordMarks marks;
};

/// Reads the headers of any sender. \param headers null: there are none
/// \return nothing if there are more than max_received_properties
std::optional<RecordHeaders> read_headers(const rd_kafka_headers_t* headers);

/// Gives the message to the library: as a TSensorMessage, or (`native`) as the bare body with metadata in headers. The
/// key is the driver's id, so that all messages of a driver go to one partition. Never blocks.
/// \param envelope encode_envelope()'s result, unless `native`; it and the message must live until the report.
/// \param now_ms the wall clock. The record has the message's time if that is near to it, because servers delete
/// records by their age. \param opaque comes back with the report. \return why it was refused.
rd_kafka_resp_err_t produce(rd_kafka_t* client, rd_kafka_topic_t* topic, const Message& message,
                            const RecordMarks& marks, bool native, std::int64_t now_ms, const EnvelopeBytes& envelope,
                            void* opaque);

struct ReadRecord {
  Message message;
  RecordMarks marks;
};

/// Reads a record of any sender. A record with our header for the driver's id has a bare body, as has every record if
/// `native`; all others must be a TSensorMessage. A large body is not copied: it keeps the record alive.
/// \return nothing for an undecodable record.
std::optional<ReadRecord> read_record(std::shared_ptr<const rd_kafka_message_t> record, bool native);

}  // namespace iotcloud::brokers::kafka
