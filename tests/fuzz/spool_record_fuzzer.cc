// A spool's records: the input as it is, and as the body of a record with a valid checksum.
#include <span>
#include <string>

#include "iotcloud/brokers/spool/store/bytes.h"
#include "iotcloud/brokers/spool/store/record.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

namespace {

using namespace iotcloud;
using brokers::spool::Decoded;

void check_record(std::string_view bytes) {
  const auto input = std::as_bytes(std::span(bytes));
  const Decoded decoded = brokers::spool::decode_record(input);
  if (decoded.kind == Decoded::Kind::incomplete) fuzz::must(decoded.size > bytes.size(), "more bytes are asked for");
  if (decoded.kind != Decoded::Kind::record) return;
  fuzz::must(decoded.size <= bytes.size(), "a record is within its bytes");
  const auto& record = decoded.record;
  std::string again;
  brokers::spool::encode_head(record.sequence, record.accepted_ms, record.message, again);
  again += record.message.payload.text();
  const Decoded second = brokers::spool::decode_record(std::as_bytes(std::span(again)));
  fuzz::must(second.kind == Decoded::Kind::record && second.record.sequence == record.sequence &&
                 second.record.message.payload == record.message.payload &&
                 second.record.message.properties == record.message.properties,
             "what was read can be written and read again");
}

/// A record with these bytes as its body and all else valid.
std::string with_good_start(std::string_view body) {
  std::string start;
  brokers::spool::put_number(start, static_cast<std::uint32_t>(body.size()));
  std::uint32_t sum = brokers::spool::checksum(std::as_bytes(std::span(start)));
  sum = brokers::spool::checksum(std::as_bytes(std::span(body)), sum);
  brokers::spool::put_number(start, sum);
  return "\xF5rec" + start + std::string(body);
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(spool_record, 40'000) {
  const std::string_view input = fuzz::text(data, size);
  check_record(input);
  check_record(with_good_start(input));
  for (std::size_t at = 0; at < size;) {
    const std::size_t next = brokers::spool::find_record(std::as_bytes(std::span(input)), at);
    if (next >= size) break;
    check_record(input.substr(next));
    at = next + 1;
  }
}
