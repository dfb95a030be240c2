#pragma once

#include <string>

namespace iotcloud::config {

inline constexpr unsigned for_owner = 0600;
inline constexpr unsigned for_readers = 0644;

/// Makes a file with these permissions. \throws Error: it is there already, or cannot be written.
void write_new_file(const std::string& file, const std::string& text, unsigned permissions);
/// A file of its owner's only, in place of what is there: who reads it sees the old text or the new one. Owner and
/// readers stay those it had. \throws Error
void replace_private_file(const std::string& file, const std::string& text);

}  // namespace iotcloud::config
