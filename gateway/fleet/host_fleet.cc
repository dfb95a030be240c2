#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/driver_of_file.h>
#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/gateway/fleet/report_check.h>
#include <iotcloud/gateway/logger.h>

namespace iotcloud::gateway {

using discovery::DriverName;
using discovery::DriverState;
using discovery::InstanceId;

namespace {

constexpr std::chrono::milliseconds retire_limit{5000};
constexpr std::size_t most_asked = 256;  ///< questions that hosts have not answered

/// The name of an instance's driver: what its order says, or else its plugin's bytes. \return empty: not known
DriverName driver_of(const discovery::OrderRecord& order, const HostOrder& host) {
  return order.driver.empty() ? host.identity.driver : order.driver;
}

/// The same for what is shown before a host reports.
DriverName driver_name(const discovery::OrderRecord& order, const HostOrder& host) {
  const DriverName known = driver_of(order, host);
  return known.empty() ? discovery::driver_of_file(order.plugin) : known;
}

/// Instances with the same key share a host. The key of an uploaded plugin contains the SHA-256 of its bytes, so each
/// version has its own host.
std::string key_of(const HostOrder& order, const InstanceId& instance) {
  std::string key = order.plugin;
  if (!order.sha256.empty()) key += "@" + order.sha256;
  if (order.isolated) key += "#" + instance;
  return key;
}

/// What the deployment says its host may connect to.
std::optional<std::string> network_of(const discovery::OrderRecord& order) {
  const auto property = order.properties.find("network");
  return property == order.properties.end() ? std::nullopt : std::optional(property->second);
}

bool isolated(const discovery::OrderRecord& order, const HostOrder& host, HostLauncher& launcher) {
  if (host.network) return true;  // others in the same process would have the same network
  const auto property = order.properties.find("isolation");
  return property != order.properties.end() ? property->second == "instance" : launcher.wants_isolation(host);
}

}  // namespace

struct HostFleet::Host {
  std::string key;
  HostOrder order;
  std::set<InstanceId> instances;
  std::unique_ptr<HostLink> link;  ///< null while the host waits for its restart
  std::chrono::milliseconds delay{0};
  int crashes = 0;                            ///< crashes in a row for which no instance is known to be at fault
  std::map<InstanceId, int> crashes_through;  ///< crashes in a row, by the instance at fault
  std::string last_end;                       ///< how the host last failed
  std::string untrue;                         ///< what it reported that cannot be; it ends for that
  std::set<InstanceId> reviving;  ///< instances that were created again after that failure and are not active yet
  config::Clock::Instant started;
  HandlerId restart_timer = 0;
};

HostFleet::HostFleet(EventLoop& loop, HostLauncher& launcher, Placement placement, Options options, OnStatus on_status)
    : loop_(loop),
      launcher_(launcher),
      placement_(std::move(placement)),
      options_(std::move(options)),
      on_status_(std::move(on_status)),
      // Not the numbers of this gateway's earlier run, whose messages an adopted host may answer for.
      last_passed_(options_.clock->wall_ms() * 1'000'000),
      last_asked_(last_passed_) {}

HostFleet::~HostFleet() = default;

std::vector<HostedInstance> HostFleet::adopt() {
  std::vector<HostedInstance> adopted;
  for (const auto& running : launcher_.running(options_.gateway)) {
    auto host = std::make_shared<Host>();
    host->order = running.order;
    if (const std::string untrue = contradiction_of(running); !untrue.empty()) {
      logger.warn("the driver host {} of {} is not adopted, but ended: {}", running.name, running.order.plugin, untrue);
      host->link = launcher_.adopt(running, events_of(host));
      retire(host, std::chrono::milliseconds{0});
      continue;
    }
    host->started = options_.clock->now();
    host->key =
        key_of(running.order, running.instances.empty() ? InstanceId() : running.instances.front().spec.order.instance);
    for (auto instance : running.instances) {
      instance.status.plugin = running.order.identity;
      const InstanceId& id = instance.spec.order.instance;
      if (members_.contains(id)) continue;
      placement_.learn(instance.status.driver, instance.spec.brokers);
      host->instances.insert(id);
      auto& member = members_[id];
      member.spec = instance.spec;
      member.host = host;
      member.status = instance.status;
      member.restarts.started(options_.clock->now());
      adopted.push_back(instance);
    }
    logger.info("adopted the driver host {} of {} with {} instance(s)", running.name, running.order.plugin,
                host->instances.size());
    host->link = launcher_.adopt(running, events_of(host));
    if (confirmed_) host->link->renew(*confirmed_);
    if (host->instances.empty() || !hosts_.emplace(host->key, host).second) retire(host, retire_limit);
  }
  return adopted;
}

std::shared_ptr<HostFleet::Host> HostFleet::host_for(const discovery::OrderRecord& order) {
  HostOrder wanted{order.plugin,     options_.gateway, false, order.sha256, {}, order.previous.has_value(),
                   network_of(order)};
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
  events.on_pass = [this, weak](const PassedMessage& message) {
    loop_.post([this, weak, message] {
      if (const auto alive = weak.lock()) pass_on(alive, message);
    });
  };
  events.on_answer = [this, weak](std::int64_t number, PassAnswer answer) {
    loop_.post([this, weak, number, answer] {
      if (const auto alive = weak.lock()) answered(alive, number, answer);
    });
  };
  events.on_told = [this, weak](std::int64_t number, const discovery::ChannelLook& look) {
    loop_.post([this, weak, number, look] {
      if (const auto alive = weak.lock()) told(alive, number, look);
    });
  };
  events.on_found = [this, weak](FoundReport report) {
    loop_.post([this, weak, report = std::move(report)] {
      const auto alive = weak.lock();
      const auto member = members_.find(report.finder);
      if (!alive || !on_found_ || member == members_.end() || member->second.host != alive || !alive->untrue.empty())
        return;
      on_found_(report);
    });
  };
  return events;
}

void HostFleet::ask(const ChannelQuestion& question, OnTold done) {
  discovery::ChannelLook answer;
  const auto found = members_.find(question.look.instance);
  if (found == members_.end()) {
    answer.problem = fmt::format("the gateway {} has no driver instance {}", options_.gateway, question.look.instance);
    done(std::move(answer));
    return;
  }
  const auto& host = found->second.host;
  if (!host || !host->link) {
    const InstanceStatus& status = found->second.status;
    answer.state = to_string(status.state);
    answer.reason = status.reason;
    answer.problem = fmt::format("instance {} is {}{}{}", question.look.instance, answer.state,
                                 status.reason.empty() ? "" : ": ", status.reason);
    done(std::move(answer));
    return;
  }
  if (asked_.size() >= most_asked) {
    answer.problem = fmt::format("{} questions wait for the answers of driver hosts; try again later", asked_.size());
    done(std::move(answer));
    return;
  }
  asked_[++last_asked_] = {host, std::move(done)};
  host->link->ask(last_asked_, question);
}

void HostFleet::told(const std::shared_ptr<Host>& by, std::int64_t number, discovery::ChannelLook look) {
  const auto found = asked_.find(number);
  if (found == asked_.end() || found->second.host.lock() != by) return;
  const OnTold done = std::move(found->second.done);
  asked_.erase(found);
  done(std::move(look));
}

/// A host has ended: it answers no question any more.
void HostFleet::lose_asked(const std::shared_ptr<Host>& host) {
  std::vector<std::int64_t> lost;
  for (const auto& [number, asked] : asked_) {
    if (asked.host.lock() == host) lost.push_back(number);
  }
  for (const auto number : lost) {
    discovery::ChannelLook look;
    look.problem = "its driver host ended before it answered";
    told(host, number, std::move(look));
  }
}

/// Passes a message that one host has read to the host that runs its instance, which must be of the same driver.
void HostFleet::pass_on(const std::shared_ptr<Host>& from, PassedMessage message) {
  if (!from->link) return;
  const auto found = members_.find(InstanceId(message.message.driver_id));
  const auto same_driver = [&](const InstanceId& id) {
    return members_.at(id).status.driver == found->second.status.driver;
  };
  if (found == members_.end() || !found->second.host || is_left_alone(found->second) ||
      std::none_of(from->instances.begin(), from->instances.end(), same_driver)) {
    from->link->answer(message.number, PassAnswer::nowhere);
    return;
  }
  const auto to = found->second.host;
  // One that failed and is to run again is not asked for before it runs: its host may not have been told yet.
  if (to == from || !to->link || found->second.removing || found->second.restarting) {
    from->link->answer(message.number, PassAnswer::comes);
    return;
  }
  passed_[++last_passed_] = {from, message.number, to};
  message.number = last_passed_;
  to->link->deliver(message);
}

void HostFleet::answered(const std::shared_ptr<Host>& by, std::int64_t number, PassAnswer answer) {
  const auto found = passed_.find(number);
  if (found == passed_.end() || found->second.to.lock() != by) return;
  const UnderWay message = found->second;
  passed_.erase(found);
  const auto from = message.from.lock();
  if (from && from->link) from->link->answer(message.number, answer);
}

/// A host has ended: it answers for no message any more, and gets no answer. A host that is started again numbers its
/// messages anew.
void HostFleet::lose_passed(const std::shared_ptr<Host>& host) {
  std::erase_if(passed_, [&](const auto& entry) { return entry.second.from.lock() == host; });
  std::vector<std::int64_t> lost;
  for (const auto& [number, message] : passed_) {
    if (message.to.lock() == host) lost.push_back(number);
  }
  for (const auto number : lost) answered(host, number, PassAnswer::comes);
}

void HostFleet::launch(const std::shared_ptr<Host>& host) {
  host->started = options_.clock->now();
  host->link = launcher_.launch(host->order, events_of(host));
  host->order.identity = host->link->plugin();
  if (confirmed_) host->link->renew(*confirmed_);
}

void HostFleet::renew(config::Clock::Instant confirmed) {
  confirmed_ = confirmed;
  for (const auto& [key, host] : hosts_) {
    if (host->link) host->link->renew(confirmed);
  }
}

void HostFleet::create(const discovery::OrderRecord& order) {
  auto host = host_for(order);
  auto& member = members_[order.instance];
  const DriverName driver = driver_name(order, host->order);
  member.spec = InstanceSpec{order, placement_.place(driver)};
  member.host = host;
  member.status.instance = order.instance;
  member.status.driver = driver;
  member.restarts.started(options_.clock->now());
  host->instances.insert(order.instance);
  report(member, DriverState::deployed, "");
  if (host->link) host->link->create(member.spec);
}

void HostFleet::activate(const InstanceId& instance) {
  auto& member = members_.at(instance);
  member.spec.order.active = true;
  if (member.host && member.host->link) member.host->link->activate(instance);
}

void HostFleet::deactivate(const InstanceId& instance) {
  auto& member = members_.at(instance);
  member.spec.order.active = false;
  if (member.host && member.host->link) member.host->link->deactivate(instance);
}

void HostFleet::remove(const InstanceId& instance, Removal removal) {
  auto& member = members_.at(instance);
  member.removing = true;
  leave_alone(member);
  if (member.host && member.host->link) {
    member.host->link->remove(instance, removal);
  } else {
    finish(instance);  // its host does not run, so nobody else reports its end
  }
}

void HostFleet::report(Member& member, DriverState state, const std::string& reason) {
  member.status.state = state;
  member.status.reason = reason;
  member.status.since_ms = options_.clock->wall_ms();
  member.status.channels.clear();
  member.status.starts_again = false;
  if (member.host) member.status.plugin = member.host->order.identity;
  on_status_(member.status);
}

std::string HostFleet::contradiction_of(const RunningHost& running) const {
  for (const auto& instance : running.instances) {
    if (std::string untrue = contradiction_of(instance, running.order); !untrue.empty()) return untrue;
    if (network_of(instance.spec.order) != running.order.network)
      return "it says that its instance was deployed with another `network` than it was started with";
  }
  return "";
}

std::string HostFleet::contradiction_of(const HostedInstance& instance, const HostOrder& host) const {
  const auto& order = instance.spec.order;
  return contradiction(instance.status, order, driver_of(order, host), options_.gateway, placement_.brokers());
}

/// Ends a host whose report cannot be true: other processes would follow it. Nobody starts it again but a person.
void HostFleet::end_liar(const std::shared_ptr<Host>& host, const std::string& untrue) {
  config::process_metrics()
      .counter("iotcloud_gateway_untrue_reports_total",
               "Reports of driver hosts that contradict the gateway's configuration; the host is ended",
               {{"plugin", host->order.plugin}})
      .add();
  host->untrue = fmt::format("its driver host reports what cannot be, and was ended: {}", untrue);
  if (host->link) host->link->shutdown(std::chrono::milliseconds{0});
}

void HostFleet::heard(const std::shared_ptr<Host>& host, const InstanceStatus& status) {
  const auto found = members_.find(status.instance);
  if (found == members_.end() || found->second.host != host || !host->untrue.empty()) return;
  if (const std::string untrue = contradiction_of({found->second.spec, status}, host->order); !untrue.empty()) {
    end_liar(host, untrue);
    return;
  }
  if (status.state == DriverState::undeployed) {
    // A host that someone else ends reports `undeployed` too, although nobody ordered it. Ignored: ended() handles the
    // end of that host.
    if (found->second.removing || shutting_down_) finish(status.instance);
    return;
  }
  Member& member = found->second;
  if (status.state == DriverState::failed && !member.removing && !shutting_down_) {
    driver_failed(host, member, status);
    return;
  }
  const bool runs = status.state == DriverState::active || status.state == DriverState::inactive;
  if (member.restarting && !runs) return;  // its record says `failed` and why until it runs again
  const bool restarted = std::exchange(member.restarting, false);
  member.status = status;
  member.status.plugin = host->order.identity;
  const bool revived = status.state == DriverState::active && host->reviving.erase(status.instance) > 0;
  if (revived && status.reason.empty()) {
    member.status.reason = fmt::format("again, after its driver host {}", host->last_end);
  } else if (restarted && status.reason.empty()) {
    member.status.reason = fmt::format("again, after it failed: {}", member.last_failure);
  }
  on_status_(member.status);
}

/// Plans the restart of an instance whose driver threw, while its host and the other instances go on.
void HostFleet::driver_failed(const std::shared_ptr<Host>& host, Member& member, const InstanceStatus& status) {
  if (member.restart_timer != 0) return;  // known already: an adopted host tells all states again
  member.status = status;
  member.status.plugin = host->order.identity;
  member.last_failure = status.reason;
  const auto pause = member.restarts.failed(options_.clock->now(), options_.restart);
  member.restarting = pause.has_value();
  member.status.starts_again = member.restarting;
  if (!pause) {
    member.status.reason =
        fmt::format("{}; that was failure {} in a row, so it is left alone until it is started again", status.reason,
                    member.restarts.failures());
    on_status_(member.status);
    return;
  }
  member.status.reason = fmt::format("{}; it is started again in {} ms", status.reason, pause->count());
  const auto start = [this, weak = std::weak_ptr<Host>(host), id = status.instance] {
    if (const auto alive = weak.lock()) start_driver_again(alive, id);
  };
  member.restart_timer = loop_.start_timer(*pause, std::chrono::microseconds{0}, start);
  on_status_(member.status);
}

void HostFleet::start_driver_again(const std::shared_ptr<Host>& host, const InstanceId& instance) {
  auto& member = members_.at(instance);  // leave_alone() stops the timer before a member goes
  member.restart_timer = 0;
  if (!host->link) return;  // start_again() creates it
  member.restarts.started(options_.clock->now());
  host->link->create(member.spec);
}

/// An instance that failed is not started again any more.
void HostFleet::leave_alone(Member& member) {
  member.restarting = false;
  loop_.stop_handler(std::exchange(member.restart_timer, 0));
}

bool HostFleet::is_left_alone(const Member& member) {
  return member.status.state == DriverState::failed && !member.restarting;
}

/// Removes an instance that has ended, then reports it, so that the listener may use its id again.
void HostFleet::finish(const InstanceId& instance) {
  const auto found = members_.find(instance);
  leave_alone(found->second);
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
  lose_passed(host);
  lose_asked(host);
  retired_.erase(host);
  const bool serving = hosts_.contains(host->key) && hosts_.at(host->key) == host;
  if (!serving || shutting_down_) {
    if (!end.reason.empty()) logger.warn("the driver host of {}: {}", host->order.plugin, end.reason);
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
  if (!host->untrue.empty()) {
    give_up(host, host->untrue);
    return;
  }
  if (end.how == HostEnd::How::crashed) {
    crashed(host, end);
    return;
  }
  give_up(host, end.reason.empty() ? "its driver host was ended" : end.reason);
}

/// Stops restarting a host: its instances stay `failed` until they are ordered to start.
void HostFleet::give_up(const std::shared_ptr<Host>& host, const std::string& reason) {
  hosts_.erase(host->key);
  logger.error("the driver host of {} does not run: {}", host->order.plugin, reason);
  for (const auto& id : host->instances) {
    auto& member = members_.at(id);
    member.host.reset();
    const bool to_tell = !is_left_alone(member);
    leave_alone(member);
    if (to_tell) report(member, DriverState::failed, reason);
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
    leave_alone(at_fault->second);
    report(at_fault->second, DriverState::failed, reason);
  }
  const auto left_alone = [&](const InstanceId& id) { return is_left_alone(members_.at(id)); };
  if (std::all_of(host->instances.begin(), host->instances.end(), left_alone)) {
    give_up(host, end.reason);
    return;
  }
  start_again_later(host, end.reason);
}

void HostFleet::start_again_later(const std::shared_ptr<Host>& host, const std::string& reason) {
  host->last_end = reason;
  host->delay = processes::next_pause(host->delay, options_.restart);
  logger.error("the driver host of {}: {}; it is started again in {} ms", host->order.plugin, reason,
               host->delay.count());
  for (const auto& id : host->instances) {
    auto& member = members_.at(id);
    if (member.status.state == DriverState::failed) continue;  // it failed before, by its own fault
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
    auto& member = members_.at(id);
    if (is_left_alone(member) || member.restart_timer != 0) continue;
    if (!member.restarting) host->reviving.insert(id);
    member.restarts.started(options_.clock->now());
    host->link->create(member.spec);
  }
}

void HostFleet::shutdown(std::chrono::milliseconds limit, std::function<void()> done) {
  shutting_down_ = true;
  on_all_ended_.push_back(std::move(done));
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
  if (!retired_.empty() || !hosts_.empty()) return;
  for (const auto& done : std::exchange(on_all_ended_, {})) done();
}

}  // namespace iotcloud::gateway
