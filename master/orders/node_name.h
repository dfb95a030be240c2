#pragma once

#include <algorithm>
#include <string>

namespace iotcloud::master {

/// Whether the text can be one name in a path of the registry, or a file's name: not empty, at most 255 bytes, no '/'
/// and no control characters, neither "." nor "..".
inline bool is_node_name(const std::string& name) {
  return !name.empty() && name.size() <= 255 && name != "." && name != ".." &&
         std::none_of(name.begin(), name.end(), [](unsigned char c) { return c == '/' || c < 0x20 || c == 0x7f; });
}

}  // namespace iotcloud::master
