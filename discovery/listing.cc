#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/directory.h>

namespace iotcloud::discovery {
namespace {

const config::Logger log{"discovery.listing"};

/// What stands below `path`, each name with its record; what went meanwhile or cannot be read is left out.
template <typename Record, typename Use>
void for_each_child(Registry& registry, const std::string& path,
                    Record (*decode)(const std::string&, const std::string&), const Use& use) {
  const auto names = registry.children(path);
  if (!names) return;
  for (const std::string& name : *names) {
    const std::string child = path + "/" + name;
    const auto node = registry.get(child);
    if (!node || node->ephemeral) continue;
    std::optional<Record> record;
    try {
      record = decode(node->data, child);
    } catch (const config::Error& error) {
      log.warn("skipped: {}", error.what());
      continue;
    }
    use(name, std::move(*record));
  }
}

}  // namespace

std::vector<DriverRecord> list_drivers(Registry& registry, const Paths& paths) {
  std::vector<DriverRecord> drivers;
  const auto names = registry.children(paths.sensors);
  if (!names) return drivers;
  for (const std::string& name : *names) {
    for_each_child(registry, paths.driver(name), decode_driver, [&](const std::string& id, DriverRecord record) {
      if (record.instance.empty()) record.instance = id;
      std::vector<ChannelRecord> channels;
      for_each_child(registry, paths.instance(name, id), decode_channel,
                     [&](const std::string&, ChannelRecord channel) { channels.push_back(std::move(channel)); });
      if (!channels.empty()) record.channels = std::move(channels);
      drivers.push_back(std::move(record));
    });
  }
  return drivers;
}

std::vector<GatewayStatus> list_gateways(Registry& registry, const Paths& paths) {
  std::vector<GatewayStatus> gateways;
  for_each_child(registry, paths.gateways, decode_gateway, [&](const std::string& id, GatewayRecord record) {
    GatewayStatus status;
    status.record = std::move(record);
    status.alive = registry.get(paths.gateway_alive(id)).has_value();
    gateways.push_back(std::move(status));
  });
  return gateways;
}

std::vector<TopologyStatus> list_topologies(Registry& registry, const Paths& paths) {
  std::vector<TopologyStatus> topologies;
  for_each_child(registry, paths.topologies, decode_topology, [&](const std::string& name, TopologyRecord record) {
    TopologyStatus status;
    status.record = std::move(record);
    status.record.name = name;
    status.workers = list_workers(registry, paths, name);
    const std::string path = paths.topology_order(name);
    try {
      if (const auto node = registry.get(path)) status.order = decode_topology_order(node->data, path);
    } catch (const config::Error& error) {
      if (dynamic_cast<const RegistryError*>(&error) != nullptr) throw;
      log.warn("skipped: {}", error.what());
    }
    topologies.push_back(std::move(status));
  });
  return topologies;
}

std::vector<WorkerRecord> list_workers(Registry& registry, const Paths& paths, const std::string& topology) {
  std::vector<WorkerRecord> workers;
  for (const std::string& name : registry.children(paths.workers(topology)).value_or(std::vector<std::string>())) {
    const std::string path = paths.workers(topology) + "/" + name;
    const auto node = registry.get(path);
    if (!node) continue;
    WorkerRecord record;
    try {
      record = decode_worker(node->data, path);
    } catch (const config::Error& error) {
      log.warn("only its name is known: {}", error.what());
    }
    record.name = name;
    workers.push_back(std::move(record));
  }
  return workers;
}

bool remove_topology(Registry& registry, const Paths& paths, const std::string& topology) {
  remove_tree(registry, paths.ended_workers(topology));
  try {
    registry.remove(paths.workers(topology));
  } catch (const RegistryError& error) {
    if (error.code() == RegistryErrorCode::not_empty) return false;
    throw;
  }
  remove_tree(registry, paths.topology(topology));
  return true;
}

}  // namespace iotcloud::discovery
