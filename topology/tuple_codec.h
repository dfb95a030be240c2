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

// A tuple as bytes, so that an engine can hand it to another process: its component, stream and values, and ids that
// only the engine understands. Field names are not sent: both sides know the topology's streams. Equal tuples have
// equal bytes, and decode_tuple() refuses bytes that encode_tuple() does not write.
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

/// The encoded parts of a tuple.
struct TupleRecord {
  std::string component;  ///< the component that emitted it
  std::string stream = default_stream;
  int source_task = -1;
  std::vector<std::uint64_t> ids;  ///< by which the engine tracks the tuple, for example of its message and its anchors
  Values values;
};

/// A decoder's limits. It checks every length in the bytes against what is left of them before it allocates.
struct TupleLimits {
  std::size_t bytes = 64U << 20;
  std::size_t name = 1024;  ///< bytes of a component's id, and of a stream's
  std::size_t fields = 4096;
  std::size_t ids = 4096;
};

/// Says why bytes are not a tuple. offset() is the position of the first byte that is wrong or missing.
class TupleFormatError : public std::runtime_error {
 public:
  TupleFormatError(std::size_t offset, const std::string& problem)
      : std::runtime_error("no tuple can be read, byte " + std::to_string(offset) + ": " + problem), offset_(offset) {}
  std::size_t offset() const { return offset_; }

 private:
  std::size_t offset_;
};

/// Appends the tuple to `out`, which grows once; each payload's bytes are copied once.
void encode_tuple(const TupleRecord& record, std::vector<std::byte>& out);
void encode_tuple(const Tuple& tuple, std::span<const std::uint64_t> ids, std::vector<std::byte>& out);

/// Reads exactly one tuple. The record's payloads share `bytes` without a copy, and keep all of it in memory.
/// \throws TupleFormatError for anything but one tuple within the limits.
TupleRecord decode_tuple(const Payload& bytes, const TupleLimits& limits = {});

}  // namespace iotcloud::topology
