#pragma once

#include <string>

namespace iotcloud::security {

inline constexpr unsigned for_owner = 0600;
inline constexpr unsigned for_readers = 0644;

/// Replaces a file, or makes one that only its owner may read: readers see the old text or the new one. An existing
/// file keeps its owner and readers. Waits for the disk. \throws Error
void replace_private_file(const std::string& file, const std::string& text);

}  // namespace iotcloud::security
