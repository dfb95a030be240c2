#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>

namespace iotcloud::brokers::spool {

/// Appends a number in little endian.
template <typename Number>
void put_number(std::string& to, Number number) {
  for (std::size_t i = 0; i < sizeof(Number); ++i) {
    to.push_back(static_cast<char>(static_cast<std::uint64_t>(number) >> (8 * i)));
  }
}

/// Reads a number from the first bytes of `from`, which must have enough of them.
template <typename Number>
Number get_number(std::span<const std::byte> from) {
  std::uint64_t number = 0;
  for (std::size_t i = 0; i < sizeof(Number); ++i) {
    number |= std::to_integer<std::uint64_t>(from[i]) << (8 * i);
  }
  return static_cast<Number>(number);
}

}  // namespace iotcloud::brokers::spool
