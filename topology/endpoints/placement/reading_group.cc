#include <algorithm>
#include <utility>

#include <iotcloud/discovery/presence.h>
#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/placement/reading_group.h>

namespace iotcloud::topology {

using discovery::RegistryError;

namespace {

/// Time between two attempts to read the members.
constexpr std::chrono::milliseconds retry_pause{500};

std::string encode(const ReadingGroup::Member& member) {
  return discovery::encode(discovery::ReaderRecord{member.topology, member.sharer.tasks, member.shares, member.broker,
                                                   member.where, member.since_ms, member.spouts, member.engine});
}

/// \throws config::Error when the bytes are no valid record.
ReadingGroup::Member decode(const std::string& worker, const std::string& bytes, const std::string& path) {
  auto reader = discovery::decode_reader(bytes, path);
  return {{worker, reader.tasks},   std::move(reader.topology), reader.shares,
          std::move(reader.broker), std::move(reader.where),    reader.since_ms,
          std::move(reader.spouts), std::move(reader.engine)};
}

std::string runs_on(const ReadingGroup::Member& member) {
  return member.engine == discovery::engine_storm ? "Apache Storm" : "workers of ours";
}

/// Why two members cannot share; empty: they can.
std::string difference(const ReadingGroup::Member& first, const ReadingGroup::Member& own) {
  const std::string who = "worker " + first.sharer.worker + " of topology \"" + first.topology + "\"";
  if (first.topology == own.topology && first.engine != own.engine && !first.engine.empty() && !own.engine.empty()) {
    return who + " runs on " + runs_on(first) + ", this one on " + runs_on(own) +
           ": they would share its drivers unseen; end one of the two, or give it another \"topology.name\"";
  }
  if (first.topology != own.topology && !(first.shares && own.shares)) {
    const discovery::TopologyName& silent = first.shares ? own.topology : first.topology;
    return who + " reads in the same group, and topology \"" + silent +
           "\" does not say that it shares: name the \"group\" in both YAML files, or another one here";
  }
  if (first.broker != own.broker) {
    return who + " reads it from broker \"" + first.broker + "\", this one from \"" + own.broker +
           "\": all spouts of a group must say the same";
  }
  if (first.where != own.where) {
    return who + " chooses drivers with \"where: " + first.where + "\", this one with \"where: " + own.where +
           "\": all spouts of a group must say the same";
  }
  return {};
}

}  // namespace

ReadingGroup::ReadingGroup(discovery::Registry& registry, std::string path, Member self, OnChange on_change)
    : registry_(registry), path_(std::move(path)), self_(std::move(self)), on_change_(std::move(on_change)) {
  member_ = registry_.hold_eventually(path_ + "/members/" + self_.sharer.worker, encode(self_));
  watch_ = registry_.watch_children(
      path_ + "/members", [this](const auto& names) { on_names(names.value_or(std::vector<std::string>())); });
}

ReadingGroup::~ReadingGroup() {
  discovery::GuardPtr again;
  {
    const config::MutexLock lock(mutex_);
    over_ = true;
    again.swap(again_);
  }
  again.reset();  // without the lock, because it waits for its callback, which takes the lock
  watch_.reset();
  member_.reset();
}

void ReadingGroup::on_names(const std::vector<std::string>& names) {
  names_ = names;
  read();
}

void ReadingGroup::read_again_soon() {
  const config::MutexLock lock(mutex_);
  if (!over_) again_ = registry_.after(retry_pause, [this] { read(); });
}

void ReadingGroup::read() {
  if (registry_.session() != discovery::SessionState::connected) {  // get_all() would block the dispatcher until then
    read_again_soon();
    return;
  }
  std::vector<std::string> paths;
  for (const auto& name : names_) {
    if (name != self_.sharer.worker) paths.push_back(path_ + "/members/" + name);
  }
  // This worker counts as a member also when its node is not listed: not yet, or not while the session is renewed.
  std::vector<Member> members{self_};
  try {
    const auto nodes = registry_.get_all(paths);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!nodes[i]) continue;  // it has just gone: the watch calls on_names() soon
      const std::string worker = paths[i].substr(paths[i].rfind('/') + 1);
      try {
        members.push_back(decode(worker, nodes[i]->data, paths[i]));
      } catch (const config::Error& error) {
        endpoints_logger.warn("{}; that worker gets no share; does it run another version?", error.what());
      }
    }
  } catch (const RegistryError& error) {
    endpoints_logger.debug("{}: {}", path_, error.what());
    read_again_soon();
    return;
  }
  tell(std::move(members));
}

void ReadingGroup::tell(std::vector<Member> members) {
  std::sort(members.begin(), members.end(), [](const Member& a, const Member& b) {
    return a.since_ms != b.since_ms ? a.since_ms < b.since_ms : a.sharer.worker < b.sharer.worker;
  });
  const Member first = members.front();
  Shares shares{{}, true, difference(first, self_)};
  for (const auto& member : members) {
    if (!difference(first, member).empty()) continue;
    shares.sharers.push_back(member.sharer);
    shares.alike = shares.alike && member.spouts == first.spouts;
  }
  on_change_(shares);
}

void ReadingGroup::clear_up(discovery::Registry& registry, const std::string& path) noexcept {
  try {
    if (registry.session() != discovery::SessionState::connected) return;
    registry.remove(path + "/members");
    discovery::remove_tree(registry, path);
    std::string parent = path;
    for (int level = 0; level < 2; ++level) {  // the driver's node, then the group's
      parent.resize(parent.rfind('/'));
      registry.remove(parent);
    }
  } catch (const std::exception& error) {
    endpoints_logger.debug("{} stays: {}", path, error.what());  // the group has a member, or the registry is away
  }
}

}  // namespace iotcloud::topology
