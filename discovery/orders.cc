// Records that only our own programs write: JSON, so that a person can read and mend them.
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {
namespace {

template <typename Record>
std::string as_text(const Record& record) {
  return to_text(to_json<nlohmann::json>(record));
}

}  // namespace

nlohmann::json parse_json(const std::string& text, const std::string& path, std::size_t longest) {
  return parse_json_as<nlohmann::json>(text, path, longest);
}

nlohmann::json parse_json(const std::string& text, const std::string& path) {
  return parse_json(text, path, max_node_size);
}

std::string encode(const OrderRecord& record) {
  return as_text(record);
}
std::string encode(const OrderRemoval& record) {
  return as_text(record);
}
std::string encode(const DrainRecord& record) {
  return as_text(record);
}
std::string encode(const TopologyRecord& record) {
  return as_text(record);
}
std::string encode(const TopologyOrder& order) {
  return as_text(order);
}
std::string encode(const WorkerRecord& record) {
  return as_text(record);
}
std::string encode(const GatewayLife& life) {
  return as_text(life);
}
std::string encode(const ReaderRecord& reader) {
  return as_text(reader);
}
std::string encode(const FreezeRecord& record) {
  return as_text(record);
}
std::string encode(const Adoption& adoption) {
  return as_text(adoption);
}

OrderRecord decode_order(const std::string& bytes, const std::string& path) {
  return from_text<OrderRecord>(bytes, path);
}
OrderRemoval decode_removal(const std::string& bytes, const std::string& path) {
  return from_text<OrderRemoval>(bytes, path);
}
DrainRecord decode_drain(const std::string& bytes, const std::string& path) {
  return from_text<DrainRecord>(bytes, path);
}
TopologyRecord decode_topology(const std::string& bytes, const std::string& path) {
  return from_text<TopologyRecord>(bytes, path);
}
TopologyOrder decode_topology_order(const std::string& bytes, const std::string& path) {
  return from_text<TopologyOrder>(bytes, path);
}
WorkerRecord decode_worker(const std::string& bytes, const std::string& path) {
  return from_text<WorkerRecord>(bytes, path);
}
FreezeRecord decode_freeze(const std::string& bytes, const std::string& path) {
  return from_text<FreezeRecord>(bytes, path);
}
Adoption decode_adoption(const std::string& bytes, const std::string& path) {
  return from_text<Adoption>(bytes, path);
}
std::string freeze_path(const Paths& paths, const GatewayId& gateway) {
  return paths.gateway(gateway) + "/frozen";
}
GatewayLife decode_life(const std::string& bytes, const std::string& path) {
  return from_text<GatewayLife>(bytes, path);
}
ReaderRecord decode_reader(const std::string& bytes, const std::string& path) {
  auto reader = from_text<ReaderRecord>(bytes, path);
  if (reader.tasks < 1 || reader.tasks > ReaderRecord::max_tasks) {
    throw config::Error(path + ": not a reader of a group: its tasks are " + std::to_string(reader.tasks) +
                        ", not 1 to " + std::to_string(ReaderRecord::max_tasks));
  }
  return reader;
}

}  // namespace iotcloud::discovery
