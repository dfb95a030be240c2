#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include <iotcloud/config/error.h>

namespace iotcloud::config::internal {

/// The place in the file of a character of a scalar value, which may be plain, quoted, a block, or folded over several
/// lines.
/// \param source the whole file. \param begin where the scalar begins in it.
/// \param offset of the character in `value`, in bytes; value.size(): after the last character that is not white space.
/// \return `begin` if escapes such as \u00e9 before the character hide its place.
Location place_in_scalar(std::string_view source, const Location& begin, std::string_view value, std::size_t offset);

}  // namespace iotcloud::config::internal
