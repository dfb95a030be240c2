#pragma once

#include <cstdint>

namespace iotcloud::bench {

/// Calls of operator new by all threads since the program began. Works only in programs that link allocations.cc, which
/// replaces the global operators.
std::uint64_t allocations();

}  // namespace iotcloud::bench
