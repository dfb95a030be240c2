#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers::spool {

/// One message in a spool.
struct Record {
  std::uint64_t sequence = 0;    ///< its place in the spool: ascending by one
  std::int64_t accepted_ms = 0;  ///< wall time (since 1970 UTC) at which the publisher took it
  Message message;
};

/// The bytes of a record before its payload, which ends it (FORMAT.md). Reused by its owner: the string keeps its room.
void encode_head(std::uint64_t sequence, std::int64_t accepted_ms, const Message& message, std::string& head);

/// Bytes before a record's body: mark, length, checksum.
inline constexpr std::size_t record_start = 12;

struct Decoded {
  enum class Kind {
    record,
    incomplete,  ///< looks like one, but more bytes are needed: `size` in all
    damaged,     ///< is none
  };
  Kind kind = Kind::damaged;
  std::size_t size = 0;  ///< of the record, in bytes; 0 when damaged
  Record record;         ///< its payload is a copy
};

/// Reads the record at the start of `bytes`, which may be anything. Never throws but for want of memory.
Decoded decode_record(std::span<const std::byte> bytes);

/// Offset of the next place from `from` on where a record may start; the end of `bytes` (less what could be the
/// beginning of a mark) when there is none.
std::size_t find_record(std::span<const std::byte> bytes, std::size_t from);

/// Of a file's start. The checksum that the spool uses everywhere: zlib's CRC-32.
std::uint32_t checksum(std::span<const std::byte> bytes, std::uint32_t so_far = 0);

}  // namespace iotcloud::brokers::spool
