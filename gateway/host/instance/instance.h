#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <shared_mutex>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/gateway/host/instance/channel_plan.h>
#include <iotcloud/gateway/host/instance/inbox.h>
#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

/// What all instances of a host share. Shared with the instances, so that one that hangs may outlive the host.
struct HostEnvironment {
  std::string gateway;
  bool isolated = false;  ///< this host runs one instance only; others of the driver are in other hosts
  std::chrono::milliseconds drain_limit{1000};
  std::string state_folder;  ///< spools are below it; empty: there are none
  std::shared_ptr<const Plugin> plugin;
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  std::unique_ptr<brokers::BrokerPool> brokers;
  std::unique_ptr<SharedInboxes> shared_inboxes;
  std::shared_ptr<EventLoop> closing;  ///< where publishers are drained, off the event threads
  std::function<void(const InstanceStatus&)> report;
};

/// One driver instance in its host: runs the driver through its life, makes its channels, and is the host that the
/// driver sees. Commands are thread safe and return at once; the outcome is reported as a state.
class Instance final : public drivers::HostInterface, public std::enable_shared_from_this<Instance> {
 public:
  Instance(std::shared_ptr<HostEnvironment> environment, InstanceSpec spec, std::shared_ptr<EventLoop> loop);
  ~Instance() override;

  void open();  ///< opens, and activates when the order says so
  void activate();
  void deactivate();
  /// Closes for good; `undeployed` is reported when everything accepted has an outcome or the drain limit passed.
  void remove();

  InstanceSpec spec() const;
  InstanceStatus status() const;
  const std::shared_ptr<EventLoop>& loop() const { return loop_; }
  /// What EventLoop::serving() says while a callback of this instance runs: unique in the process, never 0.
  std::uint64_t number() const { return number_; }
  /// Of the property `hang_limit`; see Stall::limit.
  std::optional<std::chrono::milliseconds> hang_limit() const { return hang_limit_; }

  const std::string& instance_id() const noexcept override { return id_; }
  const std::string& gateway_id() const noexcept override { return environment_->gateway; }
  const drivers::PropertyMap& properties() const noexcept override { return properties_; }
  drivers::PublishStatus publish(std::string_view channel, drivers::Message message) noexcept override;
  HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                        std::function<void()> callback) noexcept override;
  HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept override;
  void stop_handler(HandlerId id) noexcept override;
  void post(std::function<void()> callback) noexcept override;
  void log(drivers::LogLevel level, std::string_view text) noexcept override;
  void fail(std::string_view reason) noexcept override;
  void update_metadata(const drivers::PropertyMap& changes) noexcept override;

  /// The driver's metadata is reported so often at most.
  static constexpr std::chrono::milliseconds metadata_pause{200};
  /// Of all keys and values together.
  static constexpr std::size_t most_metadata = std::size_t{16} * 1024;

 private:
  struct Outgoing;
  struct Incoming;

  void open_now();
  void open_channels(const std::string& driver);
  void open_outgoing(const PlannedChannel& channel);
  /// Where the channel's messages are kept on disk. \throws config::Error when there is no place for them.
  std::string spool_folder(const std::string& channel) const;
  void open_incoming(const PlannedChannel& channel);
  void activate_now();
  void deactivate_now();
  void close_now(discovery::DriverState final_state, const std::string& reason);
  void close_driver();
  void close_incoming();
  void close_outgoing(const std::string& name, Outgoing& outgoing);
  void drain_then_report(discovery::DriverState final_state, const std::string& reason);
  bool deliver(const std::string& channel, drivers::Message message);
  /// Runs a call into the driver; an error fails the instance. \return whether it went well.
  bool call(const char* what, const std::function<void(std::string&)>& driver_call);
  void report(discovery::DriverState state, const std::string& reason);
  void report_metadata();
  void set_active(bool active);
  bool running() const { return open_ && !failing_; }

  const std::shared_ptr<HostEnvironment> environment_;
  const std::string id_;
  const drivers::PropertyMap properties_;
  const std::shared_ptr<EventLoop> loop_;
  const std::uint64_t number_;
  const std::optional<std::chrono::milliseconds> hang_limit_;

  std::atomic<bool> open_{false};
  std::atomic<bool> failing_{false};

  mutable std::mutex mutex_;
  InstanceSpec spec_;             ///< guarded by mutex_
  InstanceStatus status_;         ///< guarded by mutex_
  std::set<HandlerId> handlers_;  ///< guarded by mutex_
  bool metadata_waits_ = false;   ///< report_metadata() will run; guarded by mutex_

  std::shared_mutex channels_mutex_;
  std::map<std::string, std::shared_ptr<Outgoing>, std::less<>> outgoing_;  ///< guarded by channels_mutex_

  // Event thread only.
  bool closed_ = false;
  std::optional<config::Clock::Instant> metadata_told_;
  drivers::DriverShell* shell_ = nullptr;
  std::vector<std::unique_ptr<Incoming>> incoming_;
};

}  // namespace iotcloud::gateway
