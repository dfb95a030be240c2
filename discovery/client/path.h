#pragma once

#include <string>
#include <string_view>

namespace iotcloud::discovery {

/// \throws RegistryError bad_path unless the path is absolute and made of names that are neither empty, "." nor "..".
void check_path(std::string_view path);

/// "/a/b" -> "/a", "/a" -> "/".
std::string parent_of(const std::string& path);
/// "/a", "b" -> "/a/b".
std::string child_of(const std::string& parent, const std::string& name);
/// "/a/b" -> "b".
std::string name_of(const std::string& path);

}  // namespace iotcloud::discovery
