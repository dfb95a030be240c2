#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/master/topologies/topology_watch.h>

namespace iotcloud::master {

using discovery::Node;

TopologyWatch::TopologyWatch(discovery::Registry& registry, const discovery::Paths& paths,
                             discovery::TopologyName topology, std::int64_t revision, bool kill)
    : registry_(registry), paths_(paths), topology_(std::move(topology)), revision_(revision), kill_(kill) {}

TopologyWatch::~TopologyWatch() {
  guards_.clear();  // without the lock, because a guard waits for its callback, which may take the lock
}

void TopologyWatch::expect(const std::string& worker) {
  {
    const config::MutexLock lock(mutex_);
    expected_[worker];
  }
  guards_.push_back(registry_.watch_node(paths_.workers(topology_) + "/" + worker,
                                         [this, worker](const std::optional<Node>& node) { on_worker(worker, node); }));
}

void TopologyWatch::on_worker(const std::string& worker, const std::optional<Node>& node) {
  const config::MutexLock lock(mutex_);
  Expected& expected = expected_[worker];
  expected.gone = !node;
  if (node) {
    discovery::WorkerRecord record;
    try {
      record = discovery::decode_worker(node->data, worker);
    } catch (const config::Error& error) {
      expected.last_state = error.what();
      return;
    }
    expected.last_state = fmt::format("last state: {}, order {}", record.state, record.revision);
    if (!kill_ && record.revision >= revision_) {
      expected.outcome = record.error.empty() ? ReasonedOutcome{OrderOutcome::done, ""}
                                              : ReasonedOutcome{OrderOutcome::failed, record.error};
    }
  }
  changed_.notify_all();
}

ReasonedOutcome TopologyWatch::of_gone(const std::string& worker) {
  if (!kill_) return {OrderOutcome::failed, "it ended, or the registry lost it, before it reported"};
  const auto end = registry_.get(paths_.ended_workers(topology_) + "/" + worker);
  if (!end) return {OrderOutcome::failed, "it is gone without a word whether it drained: it crashed, or was killed"};
  if (end->data.empty()) return {OrderOutcome::done, ""};
  return {OrderOutcome::failed, "it ended, but " + end->data};
}

std::map<std::string, ReasonedOutcome> TopologyWatch::wait(std::chrono::milliseconds limit,
                                                           const std::stop_token& stop) {
  std::map<std::string, Expected> seen;
  {
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, stop, limit, [this]() IOTCLOUD_REQUIRES(mutex_) {
      return std::all_of(expected_.begin(), expected_.end(),
                         [](const auto& entry) { return entry.second.outcome || entry.second.gone; });
    });
    seen = expected_;
  }
  std::map<std::string, ReasonedOutcome> outcomes;
  for (const auto& [worker, expected] : seen) {
    if (expected.outcome) {
      outcomes[worker] = *expected.outcome;
    } else if (expected.gone) {
      outcomes[worker] = of_gone(worker);
    } else {
      outcomes[worker] = without_report(registry_, limit, stop.stop_requested(), expected.last_state);
    }
  }
  return outcomes;
}

}  // namespace iotcloud::master
