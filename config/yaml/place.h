#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include <iotcloud/config/error.h>

namespace iotcloud::config::internal {

/// Where a character of a scalar value stands in the file, be it plain, quoted, a block, or folded over several lines.
/// \param source the whole file. \param begin where the scalar begins in it.
/// \param offset of the character in `value`, in bytes; value.size(): behind the last character that is no white space.
/// \return `begin` when it cannot be told (escapes such as \u00e9 before it).
Location place_in_scalar(std::string_view source, const Location& begin, std::string_view value, std::size_t offset);

}  // namespace iotcloud::config::internal
