#include <algorithm>
#include <stdexcept>

#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/conf_keys.h>

namespace iotcloud::topology {

void refuse_unknown_keys(const Config& config, const std::string& prefix, const std::vector<std::string>& known) {
  for (const auto& [key, value] : config) {
    if (!key.starts_with(prefix) || std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::string guess = config::nearest(key, known);
    std::string list;
    for (const auto& each : known) list += (list.empty() ? "" : ", ") + each;
    throw std::invalid_argument("conf: " + key + ": unknown key; " +
                                (guess.empty() ? "known are " + list : "did you mean \"" + guess + "\"?"));
  }
}

}  // namespace iotcloud::topology
