#include <string>

#include <iotcloud/config/yaml/errors.h>

namespace iotcloud::config {

ConfigError together(const std::vector<ConfigError>& errors) {
  if (errors.size() == 1) return errors.front();
  std::string lines;
  for (const auto& error : errors) lines += (lines.empty() ? "" : "\n") + std::string(error.what());
  return {{}, "", lines, ""};
}

}  // namespace iotcloud::config
