#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/gateway/host/channel_queue.h>
#include <iotcloud/gateway/host/host_environment.h>
#include <iotcloud/gateway/host/open_channels.h>
#include <iotcloud/gateway/host/round_trips.h>

namespace iotcloud::gateway {

/// One driver instance in its host: runs the driver's life cycle, opens and closes its channels (OpenChannels has those
/// that are open), and implements the host interface that the driver uses. Commands are thread safe and return at once;
/// the outcome is reported as a state.
class DriverInstance final : public drivers::HostInterface, public std::enable_shared_from_this<DriverInstance> {
 public:
  DriverInstance(std::shared_ptr<HostEnvironment> environment, InstanceSpec spec, std::shared_ptr<EventLoop> loop);
  ~DriverInstance() override;

  void open();  ///< opens the driver, and activates it if the order says so
  void activate();
  void deactivate();
  /// Closes for good; reports `undeployed` when every accepted message has an outcome or the drain limit has passed.
  void remove(Removal removal);

  /// Closes, or is not opened at all, because its lease has run out. When it has closed it reports `inactive` with the
  /// reason, and then calls `closed`, on another thread. A failed or removed instance does neither.
  void suspend(const std::string& reason, std::function<void()> closed);

  /// Looks at a channel, or hands the driver a message. \param done called once, on any thread
  void ask(ChannelQuestion question, const std::function<void(discovery::ChannelLook)>& done);
  /// Calls `use` for each channel that is open. Thread safe.
  void each_backlog(
      const std::function<void(const discovery::ChannelRecord&, const ChannelQueue::Backlog&)>& use) const;
  void each_tally(const std::function<void(const discovery::ChannelRecord&, const ChannelTally&)>& use) const;

  /// Tells all that it has found once more, if it is a finder.
  void tell_found();

  InstanceSpec spec() const;
  InstanceStatus status() const;
  const std::shared_ptr<EventLoop>& loop() const { return loop_; }
  /// The value of EventLoop::serving() while a callback of this instance runs: unique in the process, never 0.
  std::uint64_t number() const { return number_; }
  /// Whether the driver is closed; what it published may still be on its way.
  bool driver_gone() const { return driver_gone_; }
  /// The value of the property `hang_limit`; see Stall::limit.
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
  void report_found(std::string_view key, const drivers::PropertyMap& attributes) noexcept override;
  void report_gone(std::string_view key) noexcept override;
  void report_sight(bool sees) noexcept override;

  /// Shortest time between two reports of what was found.
  static constexpr std::chrono::milliseconds found_pause{50};
  /// Shortest time between two reports of the driver's metadata.
  static constexpr std::chrono::milliseconds metadata_pause{200};
  /// Limit on the metadata: bytes of all keys and values together.
  static constexpr std::size_t most_metadata = std::size_t{16} * 1024;

 private:
  struct Incoming;

  void attempt(const std::function<void()>& part);
  void open_now();
  void check_properties() const;
  void open_channels(const discovery::DriverName& driver);
  void open_all_outgoing(const std::vector<PlannedChannel>& planned);
  void open_driver(const std::vector<PlannedChannel>& planned);
  void open_outgoing(const PlannedChannel& channel);
  void open_incoming(const PlannedChannel& channel);
  void activate_now();
  void deactivate_now();
  void close_now(discovery::DriverState final_state, const std::string& reason, std::function<void()> closed = {});
  void close_driver();
  void close_incoming();
  void drain_then_report(discovery::DriverState final_state, const std::string& reason, std::function<void()> closed);
  void end_outgoing(discovery::DriverState final_state, const std::string& reason,
                    std::vector<std::pair<std::shared_ptr<brokers::Broker>, brokers::Topic>> unneeded,
                    std::function<void()> closed);
  ChannelQueue::Handled deliver(Incoming& incoming, drivers::Message&& message, config::Clock::Instant since);
  /// Calls the driver; an error makes the instance `failed`. \return whether the call succeeded.
  bool call(const char* what, const std::function<void(std::string&)>& driver_call);
  void add_state(discovery::ChannelLook& answer) const;
  void hand(const std::string& channel, brokers::Message message,
            const std::function<void(discovery::ChannelLook)>& done);
  void report(discovery::DriverState state, const std::string& reason);
  void report_metadata();
  void change_found(const std::function<void(FoundThings&)>& change);
  void report_things(bool whole);
  void set_active(bool active);
  bool running() const { return open_ && !failing_; }

  std::atomic<bool> driver_gone_{false};
  const std::shared_ptr<HostEnvironment> environment_;
  const discovery::InstanceId id_;
  const drivers::PropertyMap properties_;
  const std::shared_ptr<EventLoop> loop_;
  const std::uint64_t number_;
  const std::optional<std::chrono::milliseconds> hang_limit_;

  std::atomic<bool> open_{false};
  std::atomic<bool> failing_{false};

  mutable config::Mutex mutex_;
  InstanceSpec spec_ IOTCLOUD_GUARDED_BY(mutex_);
  InstanceStatus status_ IOTCLOUD_GUARDED_BY(mutex_);
  std::set<HandlerId> handlers_ IOTCLOUD_GUARDED_BY(mutex_);
  FoundThings found_ IOTCLOUD_GUARDED_BY(mutex_);
  bool found_waits_ IOTCLOUD_GUARDED_BY(mutex_) = false;     ///< report_things() is started and has not run yet
  bool metadata_waits_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< report_metadata() is posted and has not run yet

  OpenChannels channels_;
  /// Set before the driver is opened; null: the instance gets no messages, so nothing answers its own.
  std::unique_ptr<RoundTrips> round_trips_;

  // Used on the event thread only.
  bool closed_ = false;
  bool failed_ = false;       ///< closed because of a failure
  bool uses_spools_ = false;  ///< its outgoing channels are opened and closed on the thread of the spools
  bool removed_ = false;
  bool undeployed_ = false;                 ///< removed for good
  std::vector<PlannedChannel> own_queues_;  ///< exclusive incoming channels that are closed
  std::optional<config::Clock::Instant> metadata_told_;
  drivers::DriverShell* shell_ = nullptr;
  std::vector<std::unique_ptr<Incoming>> incoming_;
};

}  // namespace iotcloud::gateway
