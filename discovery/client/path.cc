#include <algorithm>

#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

void check_path(std::string_view path) {
  const auto fail = [&](const std::string& problem) {
    throw RegistryError(RegistryErrorCode::bad_path,
                        "\"" + std::string(path) + "\" is no path of the form /a/b/c: " + problem);
  };
  if (path.empty() || path.front() != '/') fail("it does not begin with \"/\"");
  if (path == "/") return;
  // ZooKeeper refuses control characters.
  if (std::any_of(path.begin(), path.end(), [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7F; })) {
    fail("it contains a control character");
  }
  for (std::size_t begin = 1; begin <= path.size();) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    const std::string_view name = path.substr(begin, end - begin);
    if (name.empty()) fail("it contains an empty name");
    if (name == "." || name == "..") fail("it contains \".\" or \"..\"");
    begin = end + 1;
  }
}

std::string parent_of(const std::string& path) {
  const auto slash = path.rfind('/');
  return slash == 0 ? "/" : path.substr(0, slash);
}

std::string child_of(const std::string& parent, const std::string& name) {
  return parent == "/" ? "/" + name : parent + "/" + name;
}

std::string name_of(const std::string& path) {
  return path.substr(path.rfind('/') + 1);
}

}  // namespace iotcloud::discovery
