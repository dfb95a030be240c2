#include <optional>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/name_taken.h>
#include <iotcloud/discovery/presence.h>

namespace iotcloud::discovery {
namespace {

/// A worker of Storm that reads a channel for the topology.
struct StormReader {
  std::string worker;
  std::string what;  ///< "channel CHANNEL of driver DRIVER"
};

std::vector<std::string> children_of(Registry& registry, const std::vector<std::string>& parents) {
  std::vector<std::string> paths;
  const auto lists = registry.children_of_readable(parents);
  for (std::size_t i = 0; i < parents.size(); ++i) {
    for (const std::string& name : lists[i].value_or(std::vector<std::string>()))
      paths.push_back(child_of(parents[i], name));
  }
  return paths;
}

/// Looks at all groups, because a topology may name another than itself; in five rounds, for any number of them.
std::optional<StormReader> find_storm_reader(Registry& registry, const Paths& paths, const TopologyName& topology) {
  auto members = children_of(registry, children_of(registry, children_of(registry, {paths.groups})));
  for (auto& channel : members) channel += "/members";
  const auto readers = children_of(registry, members);
  const auto nodes = registry.get_readable(readers);
  for (std::size_t i = 0; i < readers.size(); ++i) {
    if (!nodes[i]) continue;
    ReaderRecord reader;
    try {
      reader = decode_reader(nodes[i]->data, readers[i]);
    } catch (const config::Error&) {
      continue;  // the group's members tell of it in their logs
    }
    if (reader.topology != topology || reader.engine != engine_storm) continue;
    const std::string channel = parent_of(parent_of(readers[i]));
    return StormReader{name_of(readers[i]),
                       fmt::format("channel {} of driver {}", name_of(channel), name_of(parent_of(channel)))};
  }
  return std::nullopt;
}

}  // namespace

std::string taken_by_storm(Registry& registry, const Paths& paths, const TopologyName& topology) {
  const auto reader = find_storm_reader(registry, paths, topology);
  if (!reader) return "";
  return fmt::format(
      "Apache Storm runs a topology {} already (its worker {} reads {}), and both would share its drivers unseen: end "
      "that one (`iotcloud topology kill {} --engine storm --nimbus HOST:PORT`; the registry forgets its workers "
      "within their session time-out), or give this one another \"topology.name\"",
      topology, reader->worker, reader->what, topology);
}

std::string taken_by_workers(Registry& registry, const Paths& paths, const TopologyName& topology) {
  std::string who;
  if (const auto workers = list_workers(registry, paths, topology); !workers.empty()) {
    const auto& first = workers.front();
    who = fmt::format("worker {}{}", first.name, first.host.empty() ? "" : " on " + first.host);
  } else {
    const auto submissions = list_submissions(registry, paths);
    const auto standing = submissions.find(topology);
    if (standing == submissions.end() || standing->second.submission.killed) return "";
    who = "it is submitted to the pools";
  }
  return fmt::format(
      "workers of ours run a topology {} already ({}), and both would share its drivers unseen: end that one "
      "(`iotcloud topology kill {}`), or give this one another \"topology.name\"",
      topology, who, topology);
}

}  // namespace iotcloud::discovery
