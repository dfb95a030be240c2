#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include <iotcloud/topology/value.h>

namespace iotcloud::topology::storm {

// A tuple's values as bytes, between Java and C++ in one process: both sides are of one build, so the format has no
// version, and its numbers are those of the machine (little endian), which a Java buffer reads and writes directly.
//
//   values = count(4 bytes) value*, or
//            -1(4 bytes) address(8 bytes) count(4 bytes) value*: the values stay in C++ (shim/parcel.h), and are so
//            many; the values that follow are copies of some, of which both sides know which; only from C++ to Java
//   value  = kind byte, then
//     0 null, 1 false, 2 true        nothing
//     3 integer, 4 double            8 bytes
//     5 string, 6 payload            count(4 bytes), and as many bytes
//     7 a value of a tuple           slot(4 bytes) place(4 bytes); only from C++ to Java, which keeps the tuple
//     8 an array                     nothing: it crosses by itself, in the order of the values

/// Says why bytes are no values, or why values cannot be sent.
class ValueFormatError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Where Java finds a value that is not among the bytes: at `place` of the tuple that it keeps under `slot`, or in the
/// next array that it was given.
struct JavaValue {
  static constexpr std::uint32_t next_array = 0xFFFFFFFF;  ///< in place of a slot
  std::uint32_t slot = next_array;
  std::uint32_t place = 0;
};
/// By the place of a value; those that have none, and those beyond the end, are among the bytes.
using JavaValues = std::span<const std::optional<JavaValue>>;

/// Payloads of so many bytes or more cross by themselves: with one copy in place of two.
inline constexpr std::size_t least_array = std::size_t{16} << 10;

/// Lets the large payloads that are not elsewhere already cross as arrays. \return the bytes of these
std::size_t find_arrays(std::span<const Value> values, std::vector<std::optional<JavaValue>>& elsewhere);

/// The number of bytes that encode_values() writes. \throws ValueFormatError for a string or payload of 2 GiB or more,
/// and for a string that is not UTF-8, which Java's strings cannot hold.
std::size_t encoded_size(std::span<const Value> values, JavaValues elsewhere = {});
/// Writes the values. \param at has room for encoded_size(). \return the end of what was written.
std::byte* encode_values(std::span<const Value> values, std::byte* at, JavaValues elsewhere = {}) noexcept;

/// As encoded_size(), of values that stay in C++. It looks at all of them, so that what cannot be sent is refused
/// wherever it goes. \param told the places of those that are copied
std::size_t encoded_parcel_size(std::span<const Value> values, std::span<const std::size_t> told);
/// Writes the address and number of values that stay in C++, and copies of some. \param count the values that Java's
/// tuple has. \param at has room for encoded_parcel_size(). \return the end of what was written.
std::byte* encode_parcel(const void* parcel, std::size_t count, std::span<const Value> values,
                         std::span<const std::size_t> told, std::byte* at) noexcept;

/// The arrays that came with values.
class JavaArrays {
 public:
  virtual ~JavaArrays() = default;
  /// A copy of the next one. \throws ValueFormatError when there is none.
  virtual Payload next() = 0;
};

/// Reads values; payloads are copied. \param birth if it is there, the last value, an integer, goes there instead.
/// \param arrays null: none came. \throws ValueFormatError for anything but values from the first byte to the last.
Values decode_values(std::span<const std::byte> bytes, std::int64_t* birth = nullptr, JavaArrays* arrays = nullptr);

}  // namespace iotcloud::topology::storm
