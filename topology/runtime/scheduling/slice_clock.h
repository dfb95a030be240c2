#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>

namespace iotcloud::topology::internal {

/// Real time in nanoseconds, also when the topology's clock is simulated: it measures how long threads work.
inline std::int64_t real_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// After this long a task ends its slice when its chunk of calls is over, so that others get a turn.
inline constexpr std::int64_t slice_limit_ns = 200'000;
/// The most calls of user code between two readings of the clock. Quick calls are timed as a chunk, because reading the
/// clock costs as much as such a call; slow calls are timed one by one.
inline constexpr std::size_t chunk_limit = 128;

/// How many calls the next chunk has, so that it takes some 10 us. \param chunk the limit of the last one. \param calls
/// the number of its calls. \param took_ns how long they took.
inline std::size_t next_chunk(std::size_t chunk, std::size_t calls, std::uint64_t took_ns) {
  if (took_ns > 20'000) return std::max<std::size_t>(1, calls * 10'000 / took_ns);
  if (calls == chunk && took_ns < 10'000 && chunk < chunk_limit) return 2 * chunk;
  return chunk;
}

}  // namespace iotcloud::topology::internal
