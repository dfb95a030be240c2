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
  Json json{{"instance", record.instance}, {"driver", record.driver},         {"plugin", record.plugin},
            {"active", record.active},     {"properties", record.properties}, {"metadata", record.metadata},
            {"epoch", record.epoch}};
  if (!record.name.empty()) {
    json["name"] = record.name;
    json["index"] = record.index;
  }
  if (!record.manager.empty()) json["manager"] = record.manager;
  if (record.drained) json["drained"] = true;
  if (!record.sha256.empty()) json["sha256"] = record.sha256;
  if (record.previous) json["previous"] = {{"plugin", record.previous->file}, {"sha256", record.previous->sha256}};
  return to_text(json);
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
  reader.optional("name", record.name);
  reader.optional("index", record.index);
  reader.optional("manager", record.manager);
  reader.optional("drained", record.drained);
  reader.optional("sha256", record.sha256);
  Json previous;
  reader.optional("previous", previous);
  if (!previous.is_null()) {
    const Reader detail(to_text(previous), path, "the version before an update");
    record.previous = PluginVersion{};
    detail.required("plugin", record.previous->file);
    detail.optional("sha256", record.previous->sha256);
  }
  return record;
}

std::string encode(const DrainRecord& record) {
  return to_text({{"since_ms", record.since_ms}, {"epoch", record.epoch}});
}

DrainRecord decode_drain(const std::string& bytes, const std::string& path) {
  const Reader reader(bytes, path, "the mark of a gateway that drains");
  DrainRecord record;
  reader.optional("since_ms", record.since_ms);
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

std::string encode(const TopologyOrder& order) {
  Json json{{"revision", order.revision},
            {"epoch", order.epoch},
            {"active", order.active},
            {"parallelism", order.parallelism}};
  if (order.kill) {
    json["kill"] = {{"workers", order.kill->workers},
                    {"drain_ms", order.kill->drain_ms},
                    {"awaited_until_ms", order.kill->awaited_until_ms}};
  }
  return to_text(json);
}

TopologyOrder decode_topology_order(const std::string& bytes, const std::string& path) {
  const Reader reader(bytes, path, "an order to a topology");
  TopologyOrder order;
  reader.required("revision", order.revision);
  reader.optional("epoch", order.epoch);
  reader.optional("active", order.active);
  reader.optional("parallelism", order.parallelism);
  Json kill;
  reader.optional("kill", kill);
  if (!kill.is_null()) {
    const Reader detail(to_text(kill), path, "an order to kill a topology");
    order.kill = TopologyOrder::Kill{};
    detail.required("workers", order.kill->workers);
    detail.required("drain_ms", order.kill->drain_ms);
    detail.optional("awaited_until_ms", order.kill->awaited_until_ms);
  }
  return order;
}

std::string encode(const WorkerRecord& record) {
  Json components = Json::object();
  for (const auto& [name, component] : record.components) {
    components[name] = {{"parallelism", component.parallelism}, {"tasks", component.tasks}};
  }
  return to_text({{"name", record.name},
                  {"host", record.host},
                  {"pid", record.pid},
                  {"http", record.http},
                  {"state", record.state},
                  {"revision", record.revision},
                  {"error", record.error},
                  {"since_ms", record.since_ms},
                  {"components", components}});
}

WorkerRecord decode_worker(const std::string& bytes, const std::string& path) {
  const Reader reader(bytes, path, "a worker");
  WorkerRecord record;
  reader.required("name", record.name);
  reader.optional("host", record.host);
  reader.optional("pid", record.pid);
  reader.optional("http", record.http);
  reader.optional("state", record.state);
  reader.optional("revision", record.revision);
  reader.optional("error", record.error);
  reader.optional("since_ms", record.since_ms);
  std::map<std::string, Json> components;
  reader.optional("components", components);
  for (const auto& [name, json] : components) {
    const Reader detail(to_text(json), path + ", component " + name, "a worker's component");
    detail.required("parallelism", record.components[name].parallelism);
    detail.required("tasks", record.components[name].tasks);
  }
  return record;
}

}  // namespace iotcloud::discovery
