#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace iotcloud::fuzz {

/// Changes one of the seeds (at least one is needed) in a few places. The same `number` gives the same bytes.
std::string mutation(const std::vector<std::string>& seeds, std::uint64_t number);

}  // namespace iotcloud::fuzz
