#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace iotcloud::config::internal {

/// Large enough for a fleet of some ten thousand deployments.
constexpr std::size_t most_text_bytes = std::size_t{4} << 20;

/// Checks a text for yaml-cpp, and removes a byte order mark at its beginning. yaml-cpp itself takes any bytes; some
/// silently end its reading (0x04), others become part of keys and names that nobody can type.
/// \param name stands for the file in messages.
/// \throws ConfigError for more than most_text_bytes, at the first byte that is not UTF-8, and at the first character
/// that YAML does not allow (1.2.2, section 5.1: all control characters but tab, line feed, carriage return and U+0085,
/// and U+FFFE and U+FFFF). Columns count bytes, as yaml-cpp's do.
std::string_view checked_text(std::string_view text, const std::string& name);

}  // namespace iotcloud::config::internal
