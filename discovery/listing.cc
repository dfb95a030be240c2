#include <algorithm>
#include <map>
#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/freeze.h>

namespace iotcloud::discovery {
namespace {

const config::Logger listing_logger{"discovery.listing"};

/// The record at `path`; nullopt if the node is gone, holds no record or cannot be read.
template <typename Record>
std::optional<Record> record_of(const std::optional<Node>& node, const std::string& path,
                                Record (*decode)(const std::string&, const std::string&)) {
  if (!node || node->ephemeral) return std::nullopt;
  try {
    return decode(node->data, path);
  } catch (const config::Error& error) {
    listing_logger.warn("skipped: {}", error.what());
    return std::nullopt;
  }
}

/// The paths of all children of each of `parents`, in order.
std::vector<std::string> below(Registry& registry, const std::vector<std::string>& parents,
                               Unreadable unreadable = Unreadable::left_out) {
  std::vector<std::string> paths;
  const auto lists =
      unreadable == Unreadable::throws ? registry.children_of_all(parents) : registry.children_of_readable(parents);
  for (std::size_t i = 0; i < parents.size(); ++i) {
    for (const std::string& name : lists[i].value_or(std::vector<std::string>())) {
      paths.push_back(child_of(parents[i], name));
    }
  }
  return paths;
}

/// The paths of all children of a branch. \throws RegistryError if it keeps this process out: then nothing is known.
std::vector<std::string> in_branch(Registry& registry, const std::string& branch) {
  auto paths = registry.children(branch).value_or(std::vector<std::string>());
  for (auto& path : paths) path = child_of(branch, path);
  return paths;
}

/// Calls `use` with the name and record of each child of a branch.
template <typename Record, typename Use>
void for_each_child(Registry& registry, const std::string& branch,
                    Record (*decode)(const std::string&, const std::string&), const Use& use) {
  const auto paths = in_branch(registry, branch);
  const auto nodes = registry.get_readable(paths);
  for (std::size_t i = 0; i < paths.size(); ++i) {
    if (auto record = record_of(nodes[i], paths[i], decode)) use(name_of(paths[i]), std::move(*record));
  }
}

void describe(TopologyStatus& status, const Submission& submission, std::vector<PlaceStatus> places) {
  if (submission.killed && places.empty()) return;
  status.version = submission.version.number;
  status.digest = submission.version.digest;
  status.wanted_workers = submission.workers;
  status.manager = submission.manager;
  std::sort(places.begin(), places.end(), [](const auto& a, const auto& b) { return a.place < b.place; });
  status.places = std::move(places);
}

/// A channel is its instance's, whatever its record says.
void belong_to(const DriverRecord& driver, ChannelRecord& channel) {
  channel.driver = driver.name;
  channel.instance = driver.instance;
  channel.gateway = driver.gateway;
}

}  // namespace

std::vector<std::string> list_instances(Registry& registry, const Paths& paths) {
  return below(registry, in_branch(registry, paths.sensors));
}

std::optional<DriverRecord> driver_of(const std::optional<Node>& node, const std::string& path) {
  auto driver = record_of(node, path, decode_driver);
  if (!driver) return driver;
  driver->name = DriverName(name_of(parent_of(path)));
  driver->instance = InstanceId(name_of(path));
  for (auto& channel : driver->channels) belong_to(*driver, channel);
  return driver;
}

void read_unnamed_channels(Registry& registry, const Paths& paths, std::vector<DriverRecord>& drivers) {
  std::vector<std::string> unnamed;             // instances whose records name no channels
  std::map<std::string, std::size_t> place_of;  // by path: their indexes in `drivers`
  for (std::size_t i = 0; i < drivers.size(); ++i) {
    if (!drivers[i].channels.empty()) continue;
    unnamed.push_back(paths.instance(drivers[i].name, drivers[i].instance));
    place_of[unnamed.back()] = i;
  }
  const auto channels = below(registry, unnamed);
  const auto nodes = registry.get_readable(channels);
  for (std::size_t i = 0; i < channels.size(); ++i) {
    auto channel = record_of(nodes[i], channels[i], decode_channel);
    if (!channel) continue;
    auto& driver = drivers[place_of.at(parent_of(channels[i]))];
    channel->name = name_of(channels[i]);
    belong_to(driver, *channel);
    driver.channels.push_back(std::move(*channel));
  }
}

/// Three rounds, for any number of drivers: names of drivers, names of instances, their records. Two more rounds read
/// the channels of those whose records name none.
std::vector<DriverRecord> list_drivers(Registry& registry, const Paths& paths) {
  std::vector<DriverRecord> drivers;
  const auto instances = list_instances(registry, paths);
  const auto nodes = registry.get_readable(instances);
  for (std::size_t i = 0; i < instances.size(); ++i) {
    if (auto driver = driver_of(nodes[i], instances[i])) drivers.push_back(std::move(*driver));
  }
  read_unnamed_channels(registry, paths, drivers);
  return drivers;
}

std::vector<GatewayStatus> list_gateways(Registry& registry, const Paths& paths) {
  std::vector<GatewayStatus> gateways;
  std::vector<std::string> alive, draining, frozen;
  for_each_child(registry, paths.gateways, decode_gateway, [&](const std::string& name, GatewayRecord record) {
    const GatewayId id(name);
    GatewayStatus status;
    status.record = std::move(record);
    status.record.id = id;
    alive.push_back(paths.gateway_alive(id));
    draining.push_back(paths.gateway_draining(id));
    frozen.push_back(freeze_path(paths, id));
    gateways.push_back(std::move(status));
  });
  const auto lives = registry.get_readable(alive);
  const auto marks = registry.get_readable(draining);
  const auto freezes = registry.get_readable(frozen);
  for (std::size_t i = 0; i < gateways.size(); ++i) {
    gateways[i].alive = lives[i].has_value();
    gateways[i].draining = marks[i].has_value();
    if (!freezes[i]) continue;
    const auto freeze = record_of(freezes[i], frozen[i], decode_freeze);
    gateways[i].frozen = freeze && !freeze->reason.empty() ? freeze->reason : "it does not say why";
  }
  return gateways;
}

std::vector<PlacedOrder> list_orders(Registry& registry, const Paths& paths, const std::vector<GatewayId>& gateways,
                                     Unreadable unreadable) {
  auto ids = gateways;
  if (ids.empty()) {
    for (const std::string& path : in_branch(registry, paths.gateways)) ids.emplace_back(name_of(path));
  }
  std::vector<std::string> parents;
  parents.reserve(ids.size());
  for (const GatewayId& id : ids) parents.push_back(paths.orders(id));
  std::vector<PlacedOrder> orders;
  const auto places = below(registry, parents, unreadable);
  const auto nodes = unreadable == Unreadable::throws ? registry.get_all(places) : registry.get_readable(places);
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (auto order = record_of(nodes[i], places[i], decode_order)) {
      orders.push_back({GatewayId(name_of(parent_of(parent_of(places[i])))), std::move(*order)});
    }
  }
  return orders;
}

std::string AsWantedState::to(const std::optional<TopologyOrder>& order) {
  if (order && order->kill) return "killed";
  return !order || order->active ? "active" : "inactive";
}

void AsWantedState::from(const std::string& word, std::optional<TopologyOrder>& order) {
  if (!order) order.emplace();
  order->active = word == "active";
  order->kill.reset();
  if (word == "killed") order->kill.emplace();
}

void AsRevision::from(std::int64_t revision, std::optional<TopologyOrder>& order) {
  if (!order) order.emplace();
  order->revision = revision;
}

std::vector<std::string> AsWorkerNames::to(const std::vector<WorkerRecord>& workers) {
  std::vector<std::string> names;
  names.reserve(workers.size());
  for (const auto& worker : workers) names.push_back(worker.name);
  return names;
}

std::vector<TopologyStatus> list_topologies(Registry& registry, const Paths& paths) {
  const auto submissions = list_submissions(registry, paths);
  std::map<TopologyName, std::vector<PlaceStatus>> places;
  if (!submissions.empty()) {
    for (const auto& pool : list_pools(registry, paths)) {
      for (const auto& place : pool.places) places[place.topology].push_back(place);
    }
  }
  std::vector<TopologyStatus> topologies;
  std::map<TopologyName, std::optional<Node>> nodes;
  const auto all = in_branch(registry, paths.topologies);
  auto found = registry.get_readable(all);
  for (std::size_t i = 0; i < all.size(); ++i) nodes.emplace(name_of(all[i]), std::move(found[i]));
  for (const auto& [name, submission] : submissions) nodes.try_emplace(name);
  for (const auto& [name, node] : nodes) {
    const auto submitted = submissions.find(name);
    // Without a record, a submitted topology is one that no worker has run yet, or, if it was killed, none any more.
    const bool bare = !node || node->data.empty();
    if (bare && submitted == submissions.end()) continue;
    if (bare && submitted->second.submission.killed && places[name].empty()) continue;
    const auto record = bare ? std::optional(TopologyRecord{}) : record_of(node, paths.topology(name), decode_topology);
    if (!record) continue;
    TopologyStatus status;
    status.record = *record;
    status.record.name = name;
    status.workers = list_workers(registry, paths, name);
    const std::string path = paths.topology_order(name);
    const auto order = registry.get_readable({path}).front();
    try {
      if (order) status.order = decode_topology_order(order->data, path);
    } catch (const config::Error& error) {
      listing_logger.warn("skipped: {}", error.what());
    }
    if (submitted != submissions.end()) describe(status, submitted->second.submission, std::move(places[name]));
    topologies.push_back(std::move(status));
  }
  return topologies;
}

std::vector<WorkerRecord> list_workers(Registry& registry, const Paths& paths, const TopologyName& topology) {
  std::vector<WorkerRecord> workers;
  const auto members = below(registry, {paths.workers(topology)});
  const auto nodes = registry.get_readable(members);
  for (std::size_t i = 0; i < members.size(); ++i) {
    if (!nodes[i]) continue;
    WorkerRecord record;
    try {
      record = decode_worker(nodes[i]->data, members[i]);
    } catch (const config::Error& error) {
      listing_logger.warn("only its name is known: {}", error.what());
    }
    record.name = name_of(members[i]);
    workers.push_back(std::move(record));
  }
  return workers;
}

bool remove_topology(Registry& registry, const Paths& paths, const TopologyName& topology, const Fence& fence) {
  remove_tree(registry, paths.ended_workers(topology), fence);
  try {
    registry.remove(paths.workers(topology), -1, fence);
  } catch (const RegistryError& error) {
    if (error.code() == RegistryErrorCode::not_empty) return false;
    throw;
  }
  remove_tree(registry, paths.topology(topology), fence);
  return true;
}

}  // namespace iotcloud::discovery
