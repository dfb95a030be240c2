#include "iotcloud/brokers/kafka/record.h"

#include <array>
#include <cstdlib>
#include <string>
#include <string_view>
#include <utility>

#include <iotcloud/brokers/limits.h>
#include <iotcloud/brokers/metadata_names.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers::kafka {
namespace {

// Only in this project: see RecordMarks::expires_ms.
constexpr std::string_view expires_header = "x-iotcloud-expires";

// A message's time that is further from now than this comes from a wrong clock of the device, or from a spooled
// message.
constexpr std::int64_t believable_ms = 3'600'000;
// A smaller body is copied; a larger one keeps the server's whole answer, up to a megabyte, in memory.
constexpr std::size_t worth_keeping = 4096;

bool reserved(std::string_view name) {
  return metadata::is_original(name) || name == metadata::resent_header || name == expires_header;
}

/// The library reads header names as C strings, so a zero byte is written as "%00", and "%" as "%25".
std::string header_name(const std::string& name) {
  if (name.find_first_of(std::string_view("\0%", 2)) == std::string::npos) return name;
  std::string escaped;
  for (const char c : name) {
    if (c == '\0') {
      escaped += "%00";
    } else if (c == '%') {
      escaped += "%25";
    } else {
      escaped += c;
    }
  }
  return escaped;
}

std::string property_name(std::string_view header) {
  std::string name;
  for (std::size_t i = 0; i < header.size(); ++i) {
    const std::string_view code = header.substr(i, 3);
    if (code == "%00" || code == "%25") {
      name += code == "%00" ? '\0' : '%';
      i += 2;
    } else {
      name += header[i];
    }
  }
  return name;
}

struct HeadersDestroyer {
  void operator()(rd_kafka_headers_t* headers) const { rd_kafka_headers_destroy(headers); }
};
using Headers = std::unique_ptr<rd_kafka_headers_t, HeadersDestroyer>;

void add(const Headers& headers, std::string_view name, std::string_view value) {
  rd_kafka_header_add(headers.get(), name.data(), static_cast<ssize_t>(name.size()), value.data(),
                      static_cast<ssize_t>(value.size()));
}

Headers headers_of(const Message& message, const RecordMarks& marks, bool native) {
  if (!native && !marks.resent && marks.expires_ms == 0) return nullptr;
  Headers headers(rd_kafka_headers_new(message.properties.size() + 5));
  if (marks.resent) add(headers, metadata::resent_header, "1");
  if (marks.expires_ms != 0) add(headers, expires_header, std::to_string(marks.expires_ms));
  if (!native) return headers;
  add(headers, metadata::driver, message.driver_id);
  add(headers, metadata::gateway, message.gateway_id);
  add(headers, metadata::time, std::to_string(message.time_ms));
  for (const auto& [name, value] : message.properties) {
    if (!reserved(name)) add(headers, header_name(name), value);
  }
  return headers;
}

}  // namespace

std::optional<RecordHeaders> read_headers(const rd_kafka_headers_t* headers) {
  RecordHeaders read;
  if (headers == nullptr) return read;
  const char* name_text = nullptr;
  const void* value_bytes = nullptr;
  std::size_t size = 0;
  for (std::size_t i = 0;
       rd_kafka_header_get_all(headers, i, &name_text, &value_bytes, &size) == RD_KAFKA_RESP_ERR_NO_ERROR; ++i) {
    if (i == max_received_properties) return std::nullopt;
    const std::string_view name(name_text);
    const std::string_view value(static_cast<const char*>(value_bytes), value_bytes != nullptr ? size : 0);
    if (name == metadata::driver) {
      read.message.driver_id = value;
      read.bare_body = true;
    } else if (name == metadata::gateway) {
      read.message.gateway_id = value;
    } else if (name == metadata::time) {
      read.time_ms = config::parse_number<std::int64_t>(value);
    } else if (name == metadata::resent_header) {
      read.marks.resent = true;
    } else if (name == expires_header) {
      read.marks.expires_ms = config::parse_number<std::int64_t>(value).value_or(0);
    } else {
      read.message.properties.set(property_name(name), value);
    }
  }
  return read;
}

rd_kafka_resp_err_t produce(rd_kafka_t* client, rd_kafka_topic_t* topic, const Message& message,
                            const RecordMarks& marks, bool native, std::int64_t now_ms, const EnvelopeBytes& envelope,
                            void* opaque) {
  std::array<rd_kafka_vu_t, 6> fields{};
  std::size_t count = 0;
  const auto field = [&](rd_kafka_vtype_t type) -> auto& {
    fields[count].vtype = type;
    return fields[count++].u;
  };
  const auto bytes = [&](rd_kafka_vtype_t type, const void* data, std::size_t size) {
    auto& memory = field(type).mem;
    memory.ptr = const_cast<void*>(data);  // the library takes only non-const pointers; it does not write
    memory.size = size;
  };
  field(RD_KAFKA_VTYPE_RKT).rkt = topic;
  // Always with a key: records without one would be spread over the partitions and lose their order.
  bytes(RD_KAFKA_VTYPE_KEY, message.driver_id.data(), message.driver_id.size());
  if (native) {
    bytes(RD_KAFKA_VTYPE_VALUE, message.payload.data(), message.payload.size());
  } else {
    bytes(RD_KAFKA_VTYPE_VALUE, envelope.data.get(), envelope.size);
  }
  field(RD_KAFKA_VTYPE_TIMESTAMP).i64 = std::abs(message.time_ms - now_ms) < believable_ms ? message.time_ms : now_ms;
  field(RD_KAFKA_VTYPE_OPAQUE).ptr = opaque;
  Headers headers = headers_of(message, marks, native);
  if (headers) field(RD_KAFKA_VTYPE_HEADERS).headers = headers.get();
  if (rd_kafka_error_t* error = rd_kafka_produceva(client, fields.data(), count)) {
    const rd_kafka_resp_err_t code = rd_kafka_error_code(error);
    rd_kafka_error_destroy(error);
    return code;
  }
  static_cast<void>(headers.release());  // the library owns them now
  return RD_KAFKA_RESP_ERR_NO_ERROR;
}

std::optional<ReadRecord> read_record(std::shared_ptr<const rd_kafka_message_t> record, bool native) {
  rd_kafka_headers_t* found = nullptr;
  if (rd_kafka_message_headers(record.get(), &found) != RD_KAFKA_RESP_ERR_NO_ERROR) found = nullptr;
  std::optional<RecordHeaders> headers = read_headers(found);
  if (!headers) return std::nullopt;
  std::span<const std::byte> body(static_cast<const std::byte*>(record->payload),
                                  record->payload != nullptr ? record->len : 0);
  ReadRecord read{{}, headers->marks};
  std::optional<std::int64_t> time = headers->time_ms;
  if (native || headers->bare_body) {
    read.message = std::move(headers->message);
  } else {
    std::optional<OpenedEnvelope> opened = open_envelope(body);
    if (!opened) return std::nullopt;
    read.message = std::move(opened->message);
    body = opened->body;
    time = opened->time_ms;
  }
  if (read.message.driver_id.empty() && record->key != nullptr) {
    read.message.driver_id.assign(static_cast<const char*>(record->key), record->key_len);
  }
  read.message.time_ms = time.value_or(std::max<std::int64_t>(rd_kafka_message_timestamp(record.get(), nullptr), 0));
  read.message.payload = body.size() < worth_keeping ? Payload::copy(body) : Payload::wrap(std::move(record), body);
  return read;
}

}  // namespace iotcloud::brokers::kafka
