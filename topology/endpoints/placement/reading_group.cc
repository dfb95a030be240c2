#include <algorithm>
#include <optional>

#include <nlohmann/json.hpp>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/placement/reading_group.h>

namespace iotcloud::topology {

using discovery::RegistryError;

namespace {

const config::Logger logger{"topology.endpoints"};
/// Between two attempts to read the members.
constexpr std::chrono::milliseconds retry_pause{500};

std::string encode(const ReadingGroup::Member& member) {
  return nlohmann::json{{"topology", member.topology}, {"tasks", member.sharer.tasks}, {"shares", member.shares},
                        {"broker", member.broker},     {"where", member.where},        {"since", member.since_ms}}
      .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// nullopt: it cannot be read.
std::optional<ReadingGroup::Member> decode(const std::string& worker, const std::string& bytes) {
  try {
    const auto json = nlohmann::json::parse(bytes);
    ReadingGroup::Member member;
    member.sharer = {worker, json.at("tasks").get<int>()};
    member.topology = json.at("topology").get<std::string>();
    member.shares = json.at("shares").get<bool>();
    member.broker = json.at("broker").get<std::string>();
    member.where = json.at("where").get<std::string>();
    member.since_ms = json.at("since").get<std::int64_t>();
    if (member.sharer.tasks >= 1 && member.sharer.tasks <= 1'000'000) return member;
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  }
  return std::nullopt;
}

/// Why two cannot share; empty: they can.
std::string difference(const ReadingGroup::Member& first, const ReadingGroup::Member& own) {
  const std::string who = "worker " + first.sharer.worker + " of topology \"" + first.topology + "\"";
  if (first.topology != own.topology && !(first.shares && own.shares)) {
    const std::string& silent = first.shares ? own.topology : first.topology;
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
    const std::lock_guard lock(mutex_);
    over_ = true;
    again.swap(again_);
  }
  again.reset();  // without the lock: it waits for its callback
  watch_.reset();
  member_.reset();
}

void ReadingGroup::on_names(const std::vector<std::string>& names) {
  names_ = names;
  read();
}

void ReadingGroup::read_again_soon() {
  const std::lock_guard lock(mutex_);
  if (!over_) again_ = registry_.after(retry_pause, [this] { read(); });
}

void ReadingGroup::read() {
  if (registry_.session() != discovery::SessionState::connected) {  // or the dispatcher would wait for it
    read_again_soon();
    return;
  }
  std::vector<std::string> paths;
  for (const auto& name : names_) {
    if (name != self_.sharer.worker) paths.push_back(path_ + "/members/" + name);
  }
  // Not listed yet, or not any more while the session is renewed: this worker counts all the same.
  std::vector<Member> members{self_};
  try {
    const auto nodes = registry_.get_all(paths);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!nodes[i]) continue;  // its watch follows
      const std::string worker = paths[i].substr(paths[i].rfind('/') + 1);
      if (auto member = decode(worker, nodes[i]->data)) {
        members.push_back(*std::move(member));
      } else {
        logger.warn("{} is not understood: it has no share", paths[i]);
      }
    }
  } catch (const RegistryError& error) {
    logger.debug("{}: {}", path_, error.what());
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
  std::vector<Sharer> sharers;
  for (const auto& member : members) {
    if (difference(first, member).empty()) sharers.push_back(member.sharer);
  }
  on_change_(sharers, difference(first, self_));
}

void ReadingGroup::clear_up(discovery::Registry& registry, const std::string& path) noexcept {
  try {
    if (registry.session() != discovery::SessionState::connected) return;
    registry.remove(path + "/members");
    discovery::remove_tree(registry, path);
    std::string parent = path;
    for (int level = 0; level < 2; ++level) {  // the driver's node, the group's
      parent.resize(parent.rfind('/'));
      registry.remove(parent);
    }
  } catch (const std::exception& error) {
    logger.debug("{} stays: {}", path, error.what());  // somebody is there, or the registry is not
  }
}

}  // namespace iotcloud::topology
