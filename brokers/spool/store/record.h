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
  std::uint64_t sequence = 0;    ///< its number in the spool: ascending by one
  std::int64_t accepted_ms = 0;  ///< wall time (since 1970 UTC) when the publisher accepted it
  Message message;
};

/// Encodes a record up to its payload, which comes last (FORMAT.md), into `head`. A caller that reuses `head` saves an
/// allocation.
void encode_head(std::uint64_t sequence, std::int64_t accepted_ms, const Message& message, std::string& head);

/// Bytes before a record's body: start bytes, length, checksum.
inline constexpr std::size_t record_start = 12;

struct Decoded {
  enum class Kind {
    record,
    incomplete,  ///< the beginning of a record that has at least `size` bytes
    damaged,     ///< not a record
  };
  Kind kind = Kind::damaged;
  std::size_t size = 0;  ///< of the record, in bytes; 0 if damaged
  Record record;         ///< its payload is a copy
};

/// Reads the record at the start of `bytes`, which may be anything. Throws only if memory runs out.
Decoded decode_record(std::span<const std::byte> bytes);

/// The first offset, at least `from`, at which the four start bytes of a record stand; if they stand nowhere, the
/// offset from which more bytes could complete them.
std::size_t find_record(std::span<const std::byte> bytes, std::size_t from);

/// zlib's CRC-32, the checksum of all the spool's files. \param so_far the checksum of the bytes before.
std::uint32_t checksum(std::span<const std::byte> bytes, std::uint32_t so_far = 0);

}  // namespace iotcloud::brokers::spool
