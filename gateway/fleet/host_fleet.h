#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/fleet/placement.h>
#include <iotcloud/gateway/host/event_loop.h>

namespace iotcloud::gateway {

/// How long to wait before a crashed host is started again: doubles with each crash, and starts anew after a host that
/// ran for `healthy_after`. At the crash that is number `give_up_after` in a row its instances become `failed`, and are
/// left alone until they are ordered to start. Where one instance is known to be at fault only that one's count.
struct RestartPolicy {
  std::chrono::milliseconds first{500};
  std::chrono::milliseconds longest{30000};
  std::chrono::milliseconds healthy_after{60000};
  int give_up_after = 8;  ///< 0: never
};

/// All driver hosts of one gateway: one for each plugin, or for one instance with the property `isolation: instance`.
/// Starts a host with its first instance, ends it with its last, and starts a crashed one again with its instances.
/// Used on one event loop only; `on_status` is called on it.
class HostFleet {
 public:
  struct Options {
    std::string gateway;
    RestartPolicy restart;
    const config::Clock* clock = nullptr;  ///< not null
  };
  using OnStatus = std::function<void(const InstanceStatus&)>;
  HostFleet(EventLoop& loop, HostLauncher& launcher, Placement placement, Options options, OnStatus on_status);
  ~HostFleet();

  /// Takes over what an earlier life of the gateway left running. \return the instances there are.
  std::vector<HostedInstance> adopt();

  /// The id must not be in use. Names were checked.
  void create(const discovery::OrderRecord& order);
  void activate(const std::string& instance);
  void deactivate(const std::string& instance);
  /// `undeployed` follows; then the id may be used again.
  void remove(const std::string& instance);
  /// Ends all hosts; `done` is called once when they have ended. Instances are reported as `undeployed`.
  void shutdown(std::chrono::milliseconds limit, std::function<void()> done);

 private:
  struct Host;
  struct Member {
    InstanceSpec spec;
    std::shared_ptr<Host> host;  ///< null: its plugin was refused
    InstanceStatus status;       ///< the last one reported
    bool removing = false;
  };

  std::shared_ptr<Host> host_for(const discovery::OrderRecord& order);
  HostEvents events_of(const std::shared_ptr<Host>& host);
  void launch(const std::shared_ptr<Host>& host);
  void heard(const std::shared_ptr<Host>& host, const InstanceStatus& status);
  void ended(const std::shared_ptr<Host>& host, const HostEnd& end);
  void crashed(const std::shared_ptr<Host>& host, const HostEnd& end);
  void give_up(const std::shared_ptr<Host>& host, const std::string& reason);
  void start_again_later(const std::shared_ptr<Host>& host, const std::string& reason);
  void start_again(const std::shared_ptr<Host>& host);
  void report(Member& member, discovery::DriverState state, const std::string& reason);
  void finish(const std::string& instance);
  void retire(const std::shared_ptr<Host>& host, std::chrono::milliseconds limit);
  void check_all_ended();

  EventLoop& loop_;
  HostLauncher& launcher_;
  Placement placement_;
  const Options options_;
  const OnStatus on_status_;
  std::map<std::string, Member> members_;               ///< by instance
  std::map<std::string, std::shared_ptr<Host>> hosts_;  ///< that take instances, by plugin (or plugin#instance)
  std::set<std::shared_ptr<Host>> retired_;             ///< that are ending
  std::function<void()> all_ended_;                     ///< set while shutting down
};

}  // namespace iotcloud::gateway
