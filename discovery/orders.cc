// Records that only our own programs write: JSON, so that a person can read and mend them.
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::discovery {
namespace {

using Json = nlohmann::json;

std::string to_text(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// Reads one record; keys that it does not know belong to newer programs and are passed over.
class Reader {
 public:
  /// \param what for messages: "an order".
  Reader(const std::string& bytes, const std::string& path, const std::string& what) : path_(path), what_(what) {
    try {
      json_ = Json::parse(bytes);
    } catch (const Json::exception& error) {
      throw config::Error(path_ + ": not " + what_ + " in JSON: " + error.what());
    }
    if (!json_.is_object()) throw config::Error(path_ + ": not " + what_ + ": a JSON object is wanted");
  }

  template <typename Value>
  void required(const char* key, Value& value) const {
    if (!json_.contains(key)) throw config::Error(path_ + ": not " + what_ + ": the key \"" + key + "\" is missing");
    optional(key, value);
  }

  template <typename Value>
  void optional(const char* key, Value& value) const {
    const auto found = json_.find(key);
    if (found == json_.end()) return;
    try {
      found->get_to(value);
    } catch (const Json::exception& error) {
      throw config::Error(path_ + ": not " + what_ + ": the key \"" + key + "\": " + error.what());
    }
  }

 private:
  std::string path_;
  std::string what_;
  Json json_;
};

}  // namespace

std::string encode(const OrderRecord& record) {
  return to_text({{"instance", record.instance},
                  {"driver", record.driver},
                  {"plugin", record.plugin},
                  {"active", record.active},
                  {"properties", record.properties},
                  {"metadata", record.metadata},
                  {"epoch", record.epoch}});
}

OrderRecord decode_order(const std::string& bytes, const std::string& path) {
  const Reader reader(bytes, path, "an order");
  OrderRecord record;
  reader.required("instance", record.instance);
  reader.required("plugin", record.plugin);
  reader.optional("driver", record.driver);
  reader.optional("active", record.active);
  reader.optional("properties", record.properties);
  reader.optional("metadata", record.metadata);
  reader.optional("epoch", record.epoch);
  return record;
}

std::string encode(const TopologyRecord& record) {
  return to_text(
      {{"name", record.name}, {"since_ms", record.since_ms}, {"spouts", record.spouts}, {"bolts", record.bolts}});
}

TopologyRecord decode_topology(const std::string& bytes, const std::string& path) {
  const Reader reader(bytes, path, "a topology");
  TopologyRecord record;
  reader.required("name", record.name);
  reader.optional("since_ms", record.since_ms);
  reader.optional("spouts", record.spouts);
  reader.optional("bolts", record.bolts);
  return record;
}

}  // namespace iotcloud::discovery
