#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/conf_keys.h>

namespace iotcloud::topology {

namespace {

std::string lines_of(const std::map<std::string, std::string>& keys) {
  std::string lines;
  for (const auto& [key, text] : keys) lines += fmt::format("{}conf: {}: {}", lines.empty() ? "" : "\n", key, text);
  return lines;
}

}  // namespace

ConfErrors::ConfErrors(std::map<std::string, std::string> keys)
    : std::invalid_argument(lines_of(keys)), keys_(std::move(keys)) {}

void ConfCheck::refuse_unknown_keys(const Config& config, const std::string& prefix,
                                    const std::vector<std::string>& known) {
  for (const auto& [key, value] : config) {
    if (!key.starts_with(prefix) || std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::string guess = config::nearest(key, known);
    std::string list;
    for (const auto& each : known) list += (list.empty() ? "" : ", ") + each;
    const std::string there_are = list.empty() ? "there are none here" : "known are " + list;
    refuse(key, "unknown key; " + (guess.empty() ? there_are : "did you mean \"" + guess + "\"?"));
  }
}

void ConfCheck::finish() const {
  if (!keys_.empty()) throw ConfErrors(keys_);
}

}  // namespace iotcloud::topology
