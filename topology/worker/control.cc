#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/order_times.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/topology/worker/control.h>
#include <iotcloud/topology/worker/left_behind.h>

namespace iotcloud::topology {

using discovery::Node;
using discovery::RegistryError;
using discovery::RegistryErrorCode;
using discovery::SessionState;
using discovery::TopologyKill;
using discovery::TopologyOrder;
using std::chrono::milliseconds;

namespace {

const config::Logger control_logger{"topology.control"};
/// How often a drain checks whether it is done.
constexpr milliseconds drain_pause{5};

std::map<std::string, int> parallelism_of(const Topology& topology) {
  std::map<std::string, int> parallelism;
  for (const ComponentSpec& component : topology.components) parallelism[component.id] = component.parallelism;
  return parallelism;
}

bool names(const TopologyKill& kill, const std::string& worker) {
  return std::find(kill.workers.begin(), kill.workers.end(), worker) != kill.workers.end();
}

}  // namespace

WorkerControl::WorkerControl(Options options)
    : options_(std::move(options)),
      registry_(*options_.services->registry),
      order_path_(options_.services->paths.topology_order(options_.topology.name)),
      declared_(parallelism_of(options_.runtime->topology())),
      record_(options_.worker) {
  record_.state = "inactive";
  for (const ComponentSpec& component : options_.runtime->topology().components) {
    record_.components[component.id] = {component.parallelism, component.tasks};
  }
}

void WorkerControl::start() {
  const discovery::WorkerRecord record = [this] {
    const config::MutexLock lock(mutex_);
    return record_;
  }();
  if (options_.masters) {
    keys_watch_ = options_.masters->on_change([this] {
      const config::MutexLock lock(mutex_);
      keys_changed_ = true;
      changed_.notify_all();
    });
  }
  const std::string path = options_.services->paths.workers(options_.topology.name) + "/" + record.name;
  membership_ = registry_.hold_eventually(path, discovery::encode(record), false, [this](const std::string&) {
    {
      const config::MutexLock lock(mutex_);
      joined_ = show_due_ = report_due_ = true;
      changed_.notify_all();
    }
    if (options_.on_joined) options_.on_joined();
  });
  orders_ = registry_.watch_node(order_path_, [this](const std::optional<Node>& node) { on_order(node); });
  sessions_ = registry_.on_session([this](SessionState state) {
    if (state != SessionState::connected) return;
    const config::MutexLock lock(mutex_);
    report_due_ = true;  // the last one may not have arrived
    changed_.notify_all();
  });
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

WorkerControl::~WorkerControl() {
  end();
  leave();
}

void WorkerControl::end() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void WorkerControl::on_order(const std::optional<Node>& node) {
  const config::MutexLock lock(mutex_);
  news_ = node;
  changed_.notify_all();
}

discovery::WorkerRecord WorkerControl::record() const {
  const config::MutexLock lock(mutex_);
  return record_;
}

void WorkerControl::show_trouble(const std::string& trouble) {
  const config::MutexLock lock(mutex_);
  if (record_.trouble == trouble) return;
  record_.trouble = trouble;
  report_due_ = true;
  changed_.notify_all();
}

/// A signed order waits for the worker's own node, by which the worker learns the registry's time.
bool WorkerControl::has_news() const {
  return news_ && (joined_ || !options_.masters);
}

/// Waits until there is something to do, or to look at.
void WorkerControl::await_work(const std::stop_token& stop, std::chrono::steady_clock::time_point patience) {
  const auto due = [this]()
                       IOTCLOUD_REQUIRES(mutex_) { return has_news() || show_due_ || report_due_ || keys_changed_; };
  if (spouts_activated_) {
    changed_.wait(mutex_, stop, due);
  } else {
    changed_.wait_until(mutex_, stop, patience, due);
  }
}

void WorkerControl::run(const std::stop_token& stop) {
  const auto patience = std::chrono::steady_clock::now() + options_.patience;
  while (!stop.stop_requested()) {
    std::optional<std::optional<Node>> news;
    bool show = false;
    bool tell = false;
    {
      const config::MutexLock lock(mutex_);
      await_work(stop, patience);
      if (std::exchange(keys_changed_, false) && refused_ && !news_) news_ = refused_;
      if (has_news()) news = std::exchange(news_, std::nullopt);
      show = std::exchange(show_due_, false);
      tell = std::exchange(report_due_, false);
    }
    if (stop.stop_requested()) return;
    try {
      if (news) {
        follow(*news, stop);
      } else if (!spouts_activated_ && std::chrono::steady_clock::now() >= patience) {
        control_logger.warn("the registry does not answer; topology {} runs as its YAML says until it does",
                            options_.topology.name);
        follow(TopologyOrder{});
        tell = true;
      }
      if (show && membership_) show_topology();  // a worker that was killed has left, and removed the topology's record
      if (news || show || tell) report();
    } catch (const std::exception& error) {
      control_logger.error("topology {}: {}", options_.topology.name, error.what());
    }
  }
}

void WorkerControl::follow(const std::optional<Node>& node, const std::stop_token& stop) {
  refused_.reset();
  TopologyOrder order;
  if (node) {
    try {
      order = discovery::decode_topology_order(node->data, order_path_);
    } catch (const config::Error& error) {
      control_logger.error("an order is not followed: {}", error.what());
      if (!spouts_activated_) follow(TopologyOrder{});
      const config::MutexLock lock(mutex_);
      record_.error = error.what();
      return;
    }
  }
  if (const std::string why = node ? objection(*node, order) : ""; !why.empty()) {
    refused_ = node;
    return refuse(why);
  }
  // Without a node, no order that was given before this worker's start counts from now on.
  const std::int64_t start = options_.worker.since_ms - discovery::clocks_differ.count();
  oldest_ = std::max(oldest_, node ? order.given_ms : start);
  if (const auto followed = record().revision; order.revision < followed) {
    return stay(node ? fmt::format("the registry was put back to order {}", order.revision)
                     : "the registry was emptied: there is no order");
  }
  if (!order.kill) return follow(order);
  if (names(*order.kill, record().name)) return be_killed(order, stop);
  // The kill order is for workers that ran before this one, so this worker has no order.
  forget_old_kill(order, node->version);
  follow(TopologyOrder{});
}

void WorkerControl::follow(const TopologyOrder& order) {
  spouts_activated_ = true;
  if (record().state == "draining") return;
  Runtime& runtime = *options_.runtime;
  std::vector<std::string> errors;
  const Snapshot before = runtime.snapshot();
  for (const auto& [component, declared] : declared_) {
    const auto wanted = order.parallelism.find(component);
    const int parallelism = wanted == order.parallelism.end() ? declared : wanted->second;
    const auto now = before.parallelism.find(component);
    if (now != before.parallelism.end() && now->second == parallelism) continue;
    try {
      runtime.rebalance(component, parallelism);
      control_logger.info("topology {}: component {} has parallelism {}", options_.topology.name, component,
                          parallelism);
    } catch (const std::invalid_argument& error) {
      errors.emplace_back(error.what());
    }
  }
  for (const auto& [component, parallelism] : order.parallelism) {
    if (!declared_.contains(component)) errors.push_back(fmt::format("there is no component \"{}\" here", component));
  }
  if (order.active) {
    runtime.activate();
  } else {
    runtime.deactivate();
  }
  const Snapshot after = runtime.snapshot();
  const config::MutexLock lock(mutex_);
  if (order.revision != record_.revision) {
    control_logger.info("topology {} follows order {}: {}", options_.topology.name, order.revision,
                        order.active ? "active" : "inactive");
  }
  record_.state = order.active ? "active" : "inactive";
  record_.revision = order.revision;
  record_.error = fmt::format("{}", fmt::join(errors, "; "));
  for (auto& [component, shape] : record_.components) {
    const auto now = after.parallelism.find(component);
    if (now != after.parallelism.end()) shape.parallelism = now->second;
  }
}

/// \return why an order in the registry must not be followed: no trusted master signed it, or it is older than the last
/// one, or than its node; empty: it may be followed.
std::string WorkerControl::objection(const Node& node, const TopologyOrder& order) {
  if (!options_.masters) return "";
  if (security::signer_of_object(*options_.masters, order_path_, node.data).empty())
    return "no trusted master has signed it for this topology";
  if (order.given_ms < oldest_)
    return "a master has signed it, but it is out of date: it was given before what was ordered last";
  if (written_late(node, order.given_ms))
    return "a master has signed it, but long before it was written here: somebody wrote an old one once more, or "
           "copied "
           "the registry; if it is meant, order that again";
  return "";
}

/// Whether the order was written to the registry long after its master gave it. The worker's own node tells how the
/// registry's clock differs from the worker's.
bool WorkerControl::written_late(const Node& node, std::int64_t given_ms) {
  if (!discovery::written_late(node, given_ms)) return false;
  std::int64_t ahead = 0;
  try {
    report();
    const auto own = registry_.get(options_.services->paths.workers(options_.topology.name) + "/" + record().name);
    if (own) ahead = own->modified_ms - options_.services->clock->wall_ms();
  } catch (const RegistryError& error) {
    control_logger.debug("the registry's time is not known: {}", error.what());
  }
  return discovery::written_late(node, given_ms + ahead);
}

/// Refuses an order that no trusted master wrote, or that is an old one that somebody wrote again.
void WorkerControl::refuse(const std::string& why) {
  if (!spouts_activated_) follow(TopologyOrder{});
  options_.services->metrics
      ->counter("iotcloud_topology_orders_refused_total", "Orders to this topology that no trusted master gave now")
      .add();
  const config::MutexLock lock(mutex_);
  if (killed_by_) return;
  record_.error = fmt::format("an order is refused: {}; this worker stays {}", why, record_.state);
  control_logger.error("topology {}: {}", options_.topology.name, record_.error);
}

/// The registry lost the order that this worker follows. What that order said still holds: a topology that a person
/// stopped does not start by itself.
void WorkerControl::stay(const std::string& why) {
  const config::MutexLock lock(mutex_);
  if (killed_by_) return;
  record_.error = fmt::format("{}; this worker stays {}, as order {} said: give that again, or another", why,
                              record_.state, record_.revision);
  control_logger.warn("topology {}: {}", options_.topology.name, record_.error);
}

void WorkerControl::be_killed(const TopologyOrder& order, const std::stop_token& stop) {
  spouts_activated_ = true;
  {
    const config::MutexLock lock(mutex_);
    if (killed_by_) return;
    killed_by_ = order.kill;
    record_.state = "draining";
    record_.revision = order.revision;
    record_.error.clear();
  }
  control_logger.info("topology {} is killed; what is under way has {} ms to finish", options_.topology.name,
                      order.kill->drain_ms);
  report();
  const std::string left = drain(milliseconds(order.kill->drain_ms), stop);
  if (!left.empty()) control_logger.warn("topology {}: {}", options_.topology.name, left);
  try {
    discovery::put(registry_, options_.services->paths.ended_workers(options_.topology.name) + "/" + record().name,
                   left);
  } catch (const RegistryError& error) {
    control_logger.warn("topology {}: its end could not be reported: {}", options_.topology.name, error.what());
  }
  if (options_.on_killed) options_.on_killed();
}

/// \return why tuples were left; empty if all were processed.
std::string WorkerControl::drain(milliseconds limit, const std::stop_token& stop) {
  Runtime& runtime = *options_.runtime;
  for (const auto& prepare : options_.services->before_stop) prepare();
  runtime.deactivate();
  const auto deadline = std::chrono::steady_clock::now() + limit;
  while (true) {
    const bool quiet = runtime.idle();
    const std::string left = left_behind(runtime.topology(), runtime.snapshot());
    if (quiet && left.empty()) return "";
    if (stop.stop_requested())
      return "its process was told to stop before it was done" + (left.empty() ? "" : "; " + left);
    if (std::chrono::steady_clock::now() >= deadline) {
      return fmt::format("it was not done after {} ms{}{}", limit.count(), left.empty() ? "" : "; ", left);
    }
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, stop, drain_pause, [] { return false; });
  }
}

/// Removes a kill order whose workers are all gone, if its master died before removing it.
void WorkerControl::forget_old_kill(const TopologyOrder& order, std::int64_t version) {
  const auto& paths = options_.services->paths;
  if (options_.services->clock->wall_ms() < order.kill->awaited_until_ms) return;
  try {
    const auto workers = registry_.children(paths.workers(options_.topology.name));
    for (const std::string& worker : workers.value_or(std::vector<std::string>())) {
      if (names(*order.kill, worker)) return;
    }
    registry_.remove(order_path_, version);
    discovery::remove_tree(registry_, paths.ended_workers(options_.topology.name));
  } catch (const RegistryError& error) {
    control_logger.warn("the order to kill an earlier run of {} stays: {}", options_.topology.name, error.what());
  }
}

void WorkerControl::show_topology() {
  discovery::TopologyRecord record = options_.topology;
  const auto& paths = options_.services->paths;
  const std::string path = paths.topology(record.name);
  try {
    const auto others = registry_.children(paths.workers(record.name));
    const auto before = registry_.get(path);
    if (others && others->size() > 1 && before && !before->data.empty()) {
      // other workers run already: the topology's start is that of the first of them
      record.since_ms = discovery::decode_topology(before->data, path).since_ms;
    }
    discovery::put(registry_, path, discovery::encode(record));
  } catch (const config::Error& error) {
    control_logger.warn("the record of topology {} could not be written: {}", record.name, error.what());
  }
}

void WorkerControl::report() {
  const discovery::WorkerRecord record = this->record();
  try {
    registry_.set(options_.services->paths.workers(options_.topology.name) + "/" + record.name,
                  discovery::encode(record));
  } catch (const RegistryError& error) {
    // A missing node or registry is no fault: the report is repeated when the node is made or the registry is back.
    if (error.code() != RegistryErrorCode::no_node && error.code() != RegistryErrorCode::away) {
      control_logger.warn("the record of worker {} could not be written: {}", record.name, error.what());
    }
  }
}

void WorkerControl::leave() {
  if (!membership_) return;
  orders_.reset();
  sessions_.reset();
  membership_.reset();
  if (registry_.session() != SessionState::connected) return;
  const auto& paths = options_.services->paths;
  const discovery::TopologyName& name = options_.topology.name;
  std::optional<TopologyKill> kill;
  {
    const config::MutexLock lock(mutex_);
    kill = killed_by_;
  }
  try {
    if (kill) {  // the master removes the records, unless its wait is over
      if (options_.services->clock->wall_ms() > kill->awaited_until_ms) {
        discovery::remove_topology(registry_, paths, name);
      }
      return;
    }
    registry_.remove(paths.workers(name));
    registry_.remove(paths.topology(name));
  } catch (const RegistryError& error) {
    if (error.code() != RegistryErrorCode::not_empty) {
      control_logger.warn("the record of topology {} could not be removed: {}", name, error.what());
    }
  }
}

}  // namespace iotcloud::topology
