#include "iotcloud/brokers/spool/store/record.h"

#include <algorithm>
#include <string_view>

#include <zlib.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/spool/store/bytes.h"

namespace iotcloud::brokers::spool {
namespace {

using Bytes = std::span<const std::byte>;

constexpr std::string_view record_mark = "\xF5rec";
// A record that says it has a longer body is damaged. The second term covers the ids, the properties and their lengths.
constexpr std::size_t max_body = max_payload + 8 * max_metadata;
constexpr std::size_t fixed_part =
    8 + 8 + 8 + 4 + 4 + 4;  // sequence, accepted, time, lengths of the ids, number of properties
// A higher number is damaged: no spool reaches it, and it is far below the counter's overflow.
constexpr std::uint64_t last_sequence = std::uint64_t{1} << 62;
// refusal() allows no more, because it counts 16 bytes for each.
constexpr std::uint32_t max_properties = max_metadata / 16;

void put_text(std::string& to, std::string_view text) {
  put_number(to, static_cast<std::uint32_t>(text.size()));
  to += text;
}

/// Reads fields from the front of a record's body.
class RecordFields {
 public:
  explicit RecordFields(Bytes bytes) : left_(bytes) {}

  template <typename Number>
  bool number(Number& into) {
    if (left_.size() < sizeof(Number)) return false;
    into = get_number<Number>(left_);
    left_ = left_.subspan(sizeof(Number));
    return true;
  }
  bool text(std::string& into) {
    std::uint32_t size = 0;
    if (!number(size) || left_.size() < size) return false;
    into.assign(reinterpret_cast<const char*>(left_.data()), size);
    left_ = left_.subspan(size);
    return true;
  }
  Bytes rest() const { return left_; }

 private:
  Bytes left_;
};

bool decode_body(Bytes body, Record& record) {
  RecordFields fields(body);
  std::uint32_t properties = 0;
  Message& message = record.message;
  if (!fields.number(record.sequence) || !fields.number(record.accepted_ms) || !fields.number(message.time_ms) ||
      record.sequence == 0 || record.sequence > last_sequence || !fields.text(message.driver_id) ||
      !fields.text(message.gateway_id) || !fields.number(properties) || properties > max_properties) {
    return false;
  }
  std::string name;
  std::string value;
  for (std::uint32_t i = 0; i < properties; ++i) {
    if (!fields.text(name) || !fields.text(value)) return false;
    message.properties.set(name, value);
  }
  message.payload = Payload::copy(fields.rest());
  return true;
}

}  // namespace

std::uint32_t checksum(Bytes bytes, std::uint32_t so_far) {
  if (bytes.empty()) return so_far;  // zlib would restart the checksum for a null address
  return static_cast<std::uint32_t>(
      crc32_z(so_far, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size()));
}

void encode_head(std::uint64_t sequence, std::int64_t accepted_ms, const Message& message, std::string& head) {
  head.assign(record_mark);
  head.append(record_start - record_mark.size(), '\0');
  put_number(head, sequence);
  put_number(head, accepted_ms);
  put_number(head, message.time_ms);
  put_text(head, message.driver_id);
  put_text(head, message.gateway_id);
  put_number(head, static_cast<std::uint32_t>(message.properties.size()));
  for (const auto& [name, value] : message.properties) {
    put_text(head, name);
    put_text(head, value);
  }
  std::string start;
  put_number(start, static_cast<std::uint32_t>(head.size() - record_start + message.payload.size()));
  std::uint32_t sum = checksum(std::as_bytes(std::span(start)));
  sum = checksum(std::as_bytes(std::span(head)).subspan(record_start), sum);
  sum = checksum(message.payload.bytes(), sum);
  put_number(start, sum);
  std::copy(start.begin(), start.end(), head.begin() + record_mark.size());
}

Decoded decode_record(Bytes bytes) {
  Decoded decoded;
  const std::size_t seen = std::min(bytes.size(), record_mark.size());
  if (std::memcmp(bytes.data(), record_mark.data(), seen) != 0) return decoded;
  if (bytes.size() < record_start) {
    decoded.kind = Decoded::Kind::incomplete;
    decoded.size = record_start;
    return decoded;
  }
  const Bytes length = bytes.subspan(record_mark.size(), 4);
  const std::size_t body = get_number<std::uint32_t>(length);
  if (body < fixed_part || body > max_body) return decoded;
  if (bytes.size() - record_start < body) {
    decoded.kind = Decoded::Kind::incomplete;
    decoded.size = record_start + body;
    return decoded;
  }
  const Bytes content = bytes.subspan(record_start, body);
  const auto sum = get_number<std::uint32_t>(bytes.subspan(record_mark.size() + 4));
  if (checksum(content, checksum(length)) != sum || !decode_body(content, decoded.record)) return decoded;
  decoded.kind = Decoded::Kind::record;
  decoded.size = record_start + body;
  return decoded;
}

std::size_t find_record(Bytes bytes, std::size_t from) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const std::size_t found = text.find(record_mark, from);
  if (found != std::string_view::npos) return found;
  const std::size_t kept = std::min(record_mark.size() - 1, bytes.size());
  return std::max(std::min(from, bytes.size()), bytes.size() - kept);
}

}  // namespace iotcloud::brokers::spool
