#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/number.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/submissions.h>

namespace iotcloud::discovery {
namespace {

const config::Logger submissions_logger{"discovery.submissions"};

using Names = std::vector<std::string>;

/// Calls `use` with the name and node of each of these children of `parent`, or, with `below`, of that node of each.
template <typename Use>
void for_each_node(Registry& registry, const std::string& parent, const Names& names, const std::string& below,
                   const Use& use) {
  Names paths;
  paths.reserve(names.size());
  for (const std::string& name : names) paths.push_back(child_of(parent, name) + below);
  const auto nodes = registry.get_readable(paths);
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (!nodes[i]) continue;
    try {
      use(names[i], paths[i], *nodes[i]);
    } catch (const config::Error& error) {
      submissions_logger.warn("skipped: {}", error.what());
    }
  }
}

}  // namespace

std::string encode(const Submission& submission) {
  return to_text(to_json<nlohmann::json>(submission));
}
std::string encode(const PoolRecord& record) {
  return to_text(to_json<nlohmann::json>(record));
}
std::string encode(const PlaceHolder& holder) {
  return to_text(to_json<nlohmann::json>(holder));
}
std::string encode(const TopologyHistory& history) {
  return to_text(to_json<nlohmann::json>(history));
}

Submission decode_submission(const std::string& bytes, const std::string& path) {
  auto submission = from_text<Submission>(bytes, path);
  if (submission.workers < 1 || submission.workers > Submission::most_workers || submission.pending < 0) {
    throw config::Error(
        fmt::format("{}: not a submitted topology: it has {} workers, not 1 to {}, or {} places that "
                    "wait for an update",
                    path, submission.workers, Submission::most_workers, submission.pending));
  }
  return submission;
}
TopologyHistory decode_history(const std::string& bytes, const std::string& path) {
  return from_text<TopologyHistory>(bytes, path);
}
PoolRecord decode_pool(const std::string& bytes, const std::string& path) {
  return from_text<PoolRecord>(bytes, path);
}

std::vector<PoolRecord> list_pools(Registry& registry, const Paths& paths) {
  std::vector<PoolRecord> pools;
  const auto names = registry.children(paths.pools).value_or(Names());
  for_each_node(registry, paths.pools, names, "",
                [&](const std::string& name, const std::string& path, const Node& node) {
                  auto pool = decode_pool(node.data, path);
                  pool.id = PoolId(name);
                  for (auto& place : pool.places) place.pool = pool.id;
                  pools.push_back(std::move(pool));
                });
  return pools;
}

std::map<TopologyName, StandingSubmission> list_submissions(Registry& registry, const Paths& paths) {
  std::map<TopologyName, StandingSubmission> found;
  const auto names = registry.children(paths.submissions).value_or(Names());
  for_each_node(registry, paths.submissions, names, "/wanted",
                [&](const std::string& name, const std::string& path, const Node& node) {
                  auto submission = decode_submission(node.data, path);
                  if (submission.name != name) {
                    throw config::Error(fmt::format("{}: it is for topology {}", path, submission.name));
                  }
                  found.emplace(TopologyName(name), StandingSubmission{std::move(submission), node});
                });
  return found;
}

std::map<PlaceId, PlaceHolder> list_holders(Registry& registry, const Paths& paths,
                                            const std::vector<TopologyName>& topologies) {
  std::map<PlaceId, PlaceHolder> found;
  for (const TopologyName& topology : topologies) {
    const auto places = paths.places(topology);
    const auto names = registry.children_of_readable({places}).front().value_or(Names());
    for_each_node(registry, places, names, "", [&](const std::string& name, const std::string& path, const Node& node) {
      const auto number = config::parse_number<int>(name);
      if (!number) throw config::Error(fmt::format("{}: \"{}\" is no number of a place", path, name));
      found.emplace(PlaceId{topology, *number}, from_text<PlaceHolder>(node.data, path));
    });
  }
  return found;
}

}  // namespace iotcloud::discovery
