#include <algorithm>
#include <utility>

#include <nlohmann/json.hpp>

#include <iotcloud/config/yaml/asked_keys.h>

namespace iotcloud::config {
namespace {

std::vector<AskedKey>* recorded = nullptr;

}  // namespace

void record_asked_keys(std::vector<AskedKey>* into) {
  recorded = into;
}

std::string as_json(const std::vector<AskedKey>& keys) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const AskedKey& key : keys) {
    list.push_back({{"key", key.path},
                    {"kind", key.kind},
                    {"required", key.required},
                    {"default", key.fallback},
                    {"allowed", key.allowed}});
  }
  return list.dump(1);
}

void internal::note_asked(AskedKey key) {
  if (recorded == nullptr) return;
  const auto known =
      std::find_if(recorded->begin(), recorded->end(), [&](const AskedKey& one) { return one.path == key.path; });
  if (known == recorded->end()) {
    recorded->push_back(std::move(key));
    // One reader asked whether the key exists, and a later one asked for its value.
  } else if (known->kind == "text" && key.kind != "text") {
    *known = std::move(key);
  }
}

}  // namespace iotcloud::config
