#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/fleet/placement.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/processes/restarts.h>

namespace iotcloud::gateway {

/// When a crashed host is restarted. After `give_up_after` crashes in a row the host's instances become `failed` until
/// they are ordered to start. Crashes for which one instance is known to be at fault are counted for that instance, and
/// only that one becomes `failed`. An instance whose driver threw is started again in its host by the same rules;
/// meanwhile its state is `failed`, with the reason, and its status says that it starts again.
using RestartPolicy = processes::RestartPolicy;

/// All driver hosts of one gateway: one for each plugin, or for one instance with the property `isolation: instance`.
/// The fleet starts a host for its first instance, ends it after its last one, and restarts a crashed host with its
/// instances. Used on one event loop only; `on_status` is called on it.
class HostFleet {
 public:
  struct Options {
    discovery::GatewayId gateway;
    RestartPolicy restart;
    const config::Clock* clock = nullptr;  ///< not null
  };
  using OnStatus = std::function<void(const InstanceStatus&)>;
  using OnTold = std::function<void(discovery::ChannelLook)>;
  using OnFound = std::function<void(const FoundReport&)>;
  HostFleet(EventLoop& loop, HostLauncher& launcher, Placement placement, Options options, OnStatus on_status);
  ~HostFleet();

  /// Adopts the hosts that an earlier run of the gateway left running, and ends those that report what contradicts this
  /// gateway's configuration, which may have changed. \return the adopted hosts' instances.
  std::vector<HostedInstance> adopt();

  /// The id must not be in use, and the caller has checked all names.
  void create(const discovery::OrderRecord& order);
  void activate(const discovery::InstanceId& instance);
  void deactivate(const discovery::InstanceId& instance);
  /// Begins to remove the instance. on_status reports `undeployed` when it has ended; then the id may be used again.
  /// \param removal see DriverHost::remove()
  void remove(const discovery::InstanceId& instance, Removal removal);
  /// Called, on the loop, with what instances that are finders tell, each of itself only.
  void on_found(OnFound told) { on_found_ = std::move(told); }
  /// Looks at a channel of an instance, or hands the instance a message. \param done called once, on the loop
  void ask(const ChannelQuestion& question, OnTold done);
  /// Tells all hosts, and those that are started later, when the registry last confirmed the gateway's place.
  void renew(config::Clock::Instant confirmed);
  /// Ends all hosts; `done` is called once when they have ended. Instances are reported as `undeployed`. A second call
  /// waits for the same end, and its `done` is called after the first one's.
  void shutdown(std::chrono::milliseconds limit, std::function<void()> done);

 private:
  struct Host;
  struct Member {
    InstanceSpec spec;
    std::shared_ptr<Host> host;  ///< null: its plugin was refused
    InstanceStatus status;       ///< the last one reported
    bool removing = false;
    processes::Restarts restarts;  ///< counts failures of its driver, from when it was last created in a host
    HandlerId restart_timer = 0;   ///< 0: it does not wait for its restart
    bool restarting = false;       ///< its driver failed, and it has not run since, but is to run again
    std::string last_failure;      ///< why its driver failed last
  };

  /// A message on its way from one host to another.
  struct UnderWay {
    std::weak_ptr<Host> from;
    std::int64_t number;  ///< the message's number in the host `from`
    std::weak_ptr<Host> to;
  };

  /// A question that a host has not answered.
  struct Asked {
    std::weak_ptr<Host> host;
    OnTold done;
  };

  std::shared_ptr<Host> host_for(const discovery::OrderRecord& order);
  HostEvents events_of(const std::shared_ptr<Host>& host);
  void launch(const std::shared_ptr<Host>& host);
  void heard(const std::shared_ptr<Host>& host, const InstanceStatus& status);
  std::string contradiction_of(const RunningHost& running) const;
  std::string contradiction_of(const HostedInstance& instance, const HostOrder& host) const;
  void end_liar(const std::shared_ptr<Host>& host, const std::string& untrue);
  void driver_failed(const std::shared_ptr<Host>& host, Member& member, const InstanceStatus& status);
  void start_driver_again(const std::shared_ptr<Host>& host, const discovery::InstanceId& instance);
  void leave_alone(Member& member);
  static bool is_left_alone(const Member& member);
  void pass_on(const std::shared_ptr<Host>& from, PassedMessage message);
  void answered(const std::shared_ptr<Host>& by, std::int64_t number, PassAnswer answer);
  void lose_passed(const std::shared_ptr<Host>& host);
  void told(const std::shared_ptr<Host>& by, std::int64_t number, discovery::ChannelLook look);
  void lose_asked(const std::shared_ptr<Host>& host);
  void ended(const std::shared_ptr<Host>& host, const HostEnd& end);
  void crashed(const std::shared_ptr<Host>& host, const HostEnd& end);
  void give_up(const std::shared_ptr<Host>& host, const std::string& reason);
  void start_again_later(const std::shared_ptr<Host>& host, const std::string& reason);
  void start_again(const std::shared_ptr<Host>& host);
  void report(Member& member, discovery::DriverState state, const std::string& reason);
  void finish(const discovery::InstanceId& instance);
  void retire(const std::shared_ptr<Host>& host, std::chrono::milliseconds limit);
  void check_all_ended();

  EventLoop& loop_;
  HostLauncher& launcher_;
  Placement placement_;
  const Options options_;
  const OnStatus on_status_;
  OnFound on_found_;
  std::map<discovery::InstanceId, Member> members_;
  std::map<std::string, std::shared_ptr<Host>> hosts_;  ///< the hosts that take instances, by key_of()
  std::set<std::shared_ptr<Host>> retired_;             ///< the hosts that are shutting down
  std::map<std::int64_t, UnderWay> passed_;             ///< messages passed to a host that has not answered
  std::int64_t last_passed_ = 0;                        ///< the greatest number in passed_ so far
  std::map<std::int64_t, Asked> asked_;                 ///< see ask()
  std::int64_t last_asked_ = 0;                         ///< the greatest number in asked_ so far
  std::optional<config::Clock::Instant> confirmed_;     ///< see renew()
  bool shutting_down_ = false;
  std::vector<std::function<void()>> on_all_ended_;
};

}  // namespace iotcloud::gateway
