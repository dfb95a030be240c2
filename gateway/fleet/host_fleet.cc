#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/fleet/host_fleet.h>

namespace iotcloud::gateway {

using discovery::DriverState;

namespace {

constexpr config::Logger log{"gateway"};
constexpr std::chrono::milliseconds retire_limit{5000};

std::string driver_name(const discovery::OrderRecord& order) {
  return order.driver.empty() ? order.plugin.substr(0, order.plugin.rfind('.')) : order.driver;
}

/// Instances with the same one share a host. A plugin that was sent is named by its bytes too: other bytes, another
/// host.
std::string key_of(const HostOrder& order, const std::string& instance) {
  std::string key = order.plugin;
  if (!order.sha256.empty()) key += "@" + order.sha256;
  if (order.isolated) key += "#" + instance;
  return key;
}

bool isolated(const discovery::OrderRecord& order, const HostOrder& host, HostLauncher& launcher) {
  const auto property = order.properties.find("isolation");
  return property != order.properties.end() ? property->second == "instance" : launcher.wants_isolation(host);
}

}  // namespace

struct HostFleet::Host {
  std::string key;
  HostOrder order;
  std::set<std::string> instances;
  std::unique_ptr<HostLink> link;  ///< null while it waits to be started again
  std::chrono::milliseconds delay{0};
  int crashes = 0;                             ///< in a row, nobody's fault in particular
  std::map<std::string, int> crashes_through;  ///< in a row, by the instance at fault
  std::string last_end;                        ///< why it was started again
  std::set<std::string> reviving;              ///< instances that run again since then, and are not active yet
  config::Clock::Instant started;
  HandlerId restart_timer = 0;
};

HostFleet::HostFleet(EventLoop& loop, HostLauncher& launcher, Placement placement, Options options, OnStatus on_status)
    : loop_(loop),
      launcher_(launcher),
      placement_(std::move(placement)),
      options_(std::move(options)),
      on_status_(std::move(on_status)) {}

HostFleet::~HostFleet() = default;

std::vector<HostedInstance> HostFleet::adopt() {
  std::vector<HostedInstance> adopted;
  for (const auto& running : launcher_.running(options_.gateway)) {
    auto host = std::make_shared<Host>();
    host->order = running.order;
    host->started = options_.clock->now();
    host->key = key_of(running.order, running.instances.empty() ? "" : running.instances.front().spec.order.instance);
    for (auto instance : running.instances) {
      instance.status.plugin = running.order.identity;
      const std::string& id = instance.spec.order.instance;
      if (members_.contains(id)) continue;
      placement_.learn(instance.status.driver, instance.spec.brokers);
      host->instances.insert(id);
      members_[id] = Member{instance.spec, host, instance.status};
      adopted.push_back(instance);
    }
    log.info("adopted the driver host {} of {} with {} instance(s)", running.name, running.order.plugin,
             host->instances.size());
    host->link = launcher_.adopt(running, events_of(host));
    if (host->instances.empty() || !hosts_.emplace(host->key, host).second) retire(host, retire_limit);
  }
  return adopted;
}

std::shared_ptr<HostFleet::Host> HostFleet::host_for(const discovery::OrderRecord& order) {
  HostOrder wanted{order.plugin, options_.gateway, false, order.sha256, {}};
  wanted.isolated = isolated(order, wanted, launcher_);
  const std::string key = key_of(wanted, order.instance);
  auto& host = hosts_[key];
  if (!host) {
    host = std::make_shared<Host>();
    host->key = key;
    host->order = wanted;
    launch(host);
  }
  return host;
}

HostEvents HostFleet::events_of(const std::shared_ptr<Host>& host) {
  const std::weak_ptr<Host> weak = host;
  HostEvents events;
  events.on_status = [this, weak](const InstanceStatus& status) {
    loop_.post([this, weak, status] {
      if (const auto alive = weak.lock()) heard(alive, status);
    });
  };
  events.on_ended = [this, weak](const HostEnd& end) {
    loop_.post([this, weak, end] {
      if (const auto alive = weak.lock()) ended(alive, end);
    });
  };
  return events;
}

void HostFleet::launch(const std::shared_ptr<Host>& host) {
  host->started = options_.clock->now();
  host->link = launcher_.launch(host->order, events_of(host));
  host->order.identity = host->link->plugin();
}

void HostFleet::create(const discovery::OrderRecord& order) {
  auto host = host_for(order);
  auto& member = members_[order.instance];
  member.spec = InstanceSpec{order, placement_.place(driver_name(order))};
  member.host = host;
  member.status.instance = order.instance;
  member.status.driver = driver_name(order);
  host->instances.insert(order.instance);
  report(member, DriverState::deployed, "");
  if (host->link) host->link->create(member.spec);
}

void HostFleet::activate(const std::string& instance) {
  auto& member = members_.at(instance);
  member.spec.order.active = true;
  if (member.host && member.host->link) member.host->link->activate(instance);
}

void HostFleet::deactivate(const std::string& instance) {
  auto& member = members_.at(instance);
  member.spec.order.active = false;
  if (member.host && member.host->link) member.host->link->deactivate(instance);
}

void HostFleet::remove(const std::string& instance) {
  auto& member = members_.at(instance);
  member.removing = true;
  if (member.host && member.host->link) {
    member.host->link->remove(instance);
  } else {
    finish(instance);  // its host does not run
  }
}

void HostFleet::report(Member& member, DriverState state, const std::string& reason) {
  member.status.state = state;
  member.status.reason = reason;
  member.status.since_ms = options_.clock->wall_ms();
  member.status.channels.clear();
  if (member.host) member.status.plugin = member.host->order.identity;
  on_status_(member.status);
}

void HostFleet::heard(const std::shared_ptr<Host>& host, const InstanceStatus& status) {
  const auto found = members_.find(status.instance);
  if (found == members_.end() || found->second.host != host) return;
  if (status.state == DriverState::undeployed) {
    // Told by a host that was ended by someone else, it says nothing of what is wanted: the host's end is dealt with.
    if (found->second.removing || all_ended_) finish(status.instance);
    return;
  }
  found->second.status = status;
  found->second.status.plugin = host->order.identity;
  if (status.state == DriverState::active && host->reviving.erase(status.instance) > 0 && status.reason.empty()) {
    found->second.status.reason = fmt::format("again, after its driver host {}", host->last_end);
  }
  on_status_(found->second.status);
}

/// The instance is gone. It leaves first, so that the listener may use its id again.
void HostFleet::finish(const std::string& instance) {
  const auto found = members_.find(instance);
  Member member = std::move(found->second);
  members_.erase(found);
  if (const auto host = member.host) {
    host->instances.erase(instance);
    const auto serving = hosts_.find(host->key);
    if (host->instances.empty() && serving != hosts_.end() && serving->second == host) retire(host, retire_limit);
  }
  report(member, DriverState::undeployed, "");
}

void HostFleet::retire(const std::shared_ptr<Host>& host, std::chrono::milliseconds limit) {
  const auto found = hosts_.find(host->key);
  if (found != hosts_.end() && found->second == host) hosts_.erase(found);
  loop_.stop_handler(host->restart_timer);
  if (!host->link) return;
  retired_.insert(host);
  host->link->shutdown(limit);
}

void HostFleet::ended(const std::shared_ptr<Host>& host, const HostEnd& end) {
  host->link.reset();
  retired_.erase(host);
  const bool serving = hosts_.contains(host->key) && hosts_.at(host->key) == host;
  if (!serving || all_ended_) {
    if (!end.reason.empty()) log.warn("the driver host of {}: {}", host->order.plugin, end.reason);
    const auto left = host->instances;
    for (const auto& id : left) finish(id);
    check_all_ended();
    return;
  }
  const auto instances = host->instances;
  for (const auto& id : instances) {
    if (members_.at(id).removing) finish(id);
  }
  if (host->instances.empty()) return;
  if (end.how == HostEnd::How::crashed) {
    crashed(host, end);
    return;
  }
  give_up(host, end.reason.empty() ? "its driver host was ended" : end.reason);
}

/// A person must act; orders may then be given again.
void HostFleet::give_up(const std::shared_ptr<Host>& host, const std::string& reason) {
  hosts_.erase(host->key);
  log.error("the driver host of {} does not run: {}", host->order.plugin, reason);
  for (const auto& id : host->instances) {
    auto& member = members_.at(id);
    member.host.reset();
    if (member.status.state != DriverState::failed) report(member, DriverState::failed, reason);
  }
}

void HostFleet::crashed(const std::shared_ptr<Host>& host, const HostEnd& end) {
  const auto& policy = options_.restart;
  config::process_metrics()
      .counter("iotcloud_gateway_host_failures_total", "Driver hosts that crashed, hung, spun or took too much",
               {{"plugin", host->order.plugin}})
      .add();
  if (options_.clock->now() - host->started >= policy.healthy_after) {
    host->crashes = 0;
    host->crashes_through.clear();
    host->delay = std::chrono::milliseconds{0};
  }
  const auto at_fault = members_.find(end.instance);
  const bool known = at_fault != members_.end() && at_fault->second.host == host;
  const int crashes = known ? ++host->crashes_through[end.instance] : ++host->crashes;
  if (policy.give_up_after > 0 && crashes >= policy.give_up_after) {
    const auto reason = fmt::format(
        "its driver host {}; that was failure {} in a row, so it is left alone until it is "
        "started again",
        end.reason, crashes);
    if (!known || host->instances.size() == 1) {
      give_up(host, reason);
      return;
    }
    report(at_fault->second, DriverState::failed, reason);
  }
  const auto has_failed = [&](const std::string& id) { return members_.at(id).status.state == DriverState::failed; };
  if (std::all_of(host->instances.begin(), host->instances.end(), has_failed)) {
    give_up(host, end.reason);
    return;
  }
  start_again_later(host, end.reason);
}

void HostFleet::start_again_later(const std::shared_ptr<Host>& host, const std::string& reason) {
  host->last_end = reason;
  host->delay = host->delay.count() == 0 ? options_.restart.first : std::min(host->delay * 2, options_.restart.longest);
  log.error("the driver host of {}: {}; it is started again in {} ms", host->order.plugin, reason, host->delay.count());
  for (const auto& id : host->instances) {
    auto& member = members_.at(id);
    if (member.status.state == DriverState::failed) continue;  // by its own fault, before: it stays so
    report(member, DriverState::starting,
           fmt::format("its driver host {}; it is started again in {} ms", reason, host->delay.count()));
  }
  host->restart_timer =
      loop_.start_timer(host->delay, std::chrono::microseconds{0}, [this, weak = std::weak_ptr<Host>(host)] {
        if (const auto alive = weak.lock()) start_again(alive);
      });
}

void HostFleet::start_again(const std::shared_ptr<Host>& host) {
  if (!hosts_.contains(host->key) || hosts_.at(host->key) != host) return;
  launch(host);
  for (const auto& id : host->instances) {
    const auto& member = members_.at(id);
    if (member.status.state == DriverState::failed) continue;
    host->reviving.insert(id);
    host->link->create(member.spec);
  }
}

void HostFleet::shutdown(std::chrono::milliseconds limit, std::function<void()> done) {
  all_ended_ = std::move(done);
  const auto hosts = hosts_;
  for (const auto& [key, host] : hosts) {
    retire(host, limit);
    if (host->link) continue;
    const auto left = host->instances;
    for (const auto& id : left) finish(id);
  }
  check_all_ended();
}

void HostFleet::check_all_ended() {
  if (!all_ended_ || !retired_.empty() || !hosts_.empty()) return;
  const auto done = std::exchange(all_ended_, nullptr);
  done();
}

}  // namespace iotcloud::gateway
