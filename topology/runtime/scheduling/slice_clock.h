#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>

namespace iotcloud::topology::internal {

/// Real time, also when the topology's clock is a simulated one: how long a thread has been at it.
inline std::int64_t real_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// A task gives way to others that are ready after this long.
inline constexpr std::int64_t slice_limit_ns = 200'000;
/// Calls between two looks at the clock: as many as fit in some microseconds, so that quick calls are timed as a batch
/// (a look costs as much as the call) and slow ones singly.
inline constexpr std::size_t chunk_limit = 128;

inline std::size_t next_chunk(std::size_t chunk, std::size_t calls, std::uint64_t took_ns) {
  if (took_ns > 20'000) return std::max<std::size_t>(1, calls * 10'000 / took_ns);
  if (calls == chunk && took_ns < 10'000 && chunk < chunk_limit) return 2 * chunk;
  return chunk;
}

}  // namespace iotcloud::topology::internal
