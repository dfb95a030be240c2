#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>

#include <iotcloud/topology/value.h>

namespace iotcloud::topology::storm {

// A tuple's values as bytes, between Java and C++ in one process: both sides are of one build, so the format has no
// version, and its numbers are those of the machine (little endian), which a Java buffer reads and writes directly.
//
//   values = count(4 bytes) value*
//   value  = kind byte, then
//     0 null, 1 false, 2 true        nothing
//     3 integer, 4 double            8 bytes
//     5 string, 6 payload            count(4 bytes), and as many bytes

/// Says why bytes are no values, or why values cannot be sent.
class ValueFormatError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The number of bytes that encode_values() writes. \throws ValueFormatError for a string or payload of 2 GiB or more,
/// and for a string that is not UTF-8, which Java's strings cannot hold.
std::size_t encoded_size(std::span<const Value> values);
/// Writes the values. \param at has room for encoded_size(). \return the end of what was written.
std::byte* encode_values(std::span<const Value> values, std::byte* at) noexcept;

/// Reads values; payloads are copied. \param birth if it is there, the last value, an integer, goes there instead.
/// \throws ValueFormatError for anything but values from the first byte to the last.
Values decode_values(std::span<const std::byte> bytes, std::int64_t* birth = nullptr);

}  // namespace iotcloud::topology::storm
