#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include <iotcloud/topology/tuple.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

// A tuple as bytes, so that an engine can hand it to another process: who emitted it, to which stream, its values, and
// ids that mean something to the engine only. The names of the fields are not sent: both sides know the streams of the
// topology. Equal tuples have equal bytes, and bytes that are not what encode_tuple() writes are refused.
//
//   tuple  = magic version name(component) name(stream) number(source task) count ids* count value*
//   magic  = 0xC7                    one byte
//   version = 0x01                   one byte; other versions are refused
//   ids    = 8 bytes, little endian
//   value  = kind byte, then
//     0 null, 1 false, 2 true        nothing
//     3 integer                      number
//     4 double                       8 bytes, IEEE 754, little endian
//     5 string, 6 payload            count, and as many bytes
//   name   = count, and as many bytes (any bytes)
//   count  = the unsigned number in groups of 7 bits, the lowest first; the highest bit of a byte says that another
//            follows (LEB128); no more bytes than needed
//   number = count of the zigzag code: 0, -1, 1, -2, 2 ... become 0, 1, 2, 3, 4 ...

/// What is sent of a tuple.
struct TupleRecord {
  std::string component;  ///< that emitted it
  std::string stream = default_stream;
  int source_task = -1;
  std::vector<std::uint64_t> ids;  ///< the engine's, to track it: the message and the anchors, say
  Values values;
};

/// What a decoder takes at most. Whatever the bytes claim, it allocates no more than they hold.
struct TupleLimits {
  std::size_t bytes = 64U << 20;
  std::size_t name = 1024;  ///< bytes of a component's id, and of a stream's
  std::size_t fields = 4096;
  std::size_t ids = 4096;
};

/// Bytes that are no tuple. `offset`: of the first byte that is wrong or missing.
class TupleFormatError : public std::runtime_error {
 public:
  TupleFormatError(std::size_t offset, const std::string& problem)
      : std::runtime_error("no tuple can be read, byte " + std::to_string(offset) + ": " + problem), offset_(offset) {}
  std::size_t offset() const { return offset_; }

 private:
  std::size_t offset_;
};

/// Appends the tuple to `out` in one growth; each payload's bytes are copied once.
void encode_tuple(const TupleRecord& record, std::vector<std::byte>& out);
void encode_tuple(const Tuple& tuple, std::span<const std::uint64_t> ids, std::vector<std::byte>& out);

/// Reads exactly one tuple. Payloads of the record share `bytes` (no copy), and so keep all of them in memory.
/// \throws TupleFormatError for anything that is not one tuple within the limits.
TupleRecord decode_tuple(const Payload& bytes, const TupleLimits& limits = {});

}  // namespace iotcloud::topology
