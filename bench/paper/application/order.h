#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

namespace iotcloud::bench::paper {

/// The messages that all drivers of a measurement send, and when. Times are those of the machine's monotonic clock
/// (now_ns()), so driver hosts that read the same order send in step.
struct Order {
  std::uint64_t id = 0;  ///< counts up from 1
  std::size_t size = 0;  ///< bytes of a message
  double rate = 0;       ///< messages a second of each driver
  unsigned drivers = 0;  ///< in all hosts; their turns are spread evenly over 1/rate
  std::int64_t start_ns = 0;
  /// Messages that are due from `from_ns` on are timed; earlier ones warm up.
  std::int64_t from_ns = 0, until_ns = 0;
  std::int64_t patience_ns = 0;  ///< messages that come back later than this after `until_ns` are not waited for

  /// When a driver must send a message. \param turn of the driver, 0 to `drivers` - 1. \param number 0, 1, 2, ...
  std::int64_t intended_ns(unsigned turn, std::uint64_t number) const;
  /// How many messages a driver sends: those due before `until_ns`.
  std::uint64_t messages(unsigned turn) const;
};

/// Reads a file with one line that has the members above, in that order. Nothing if the file does not exist.
/// \throws std::runtime_error for any other contents.
std::optional<Order> read_order(const std::string& file);

}  // namespace iotcloud::bench::paper
