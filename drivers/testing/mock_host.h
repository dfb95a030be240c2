#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/drivers/plugin.h>

/// Tests a driver without a gateway: link iotcloud::drivers_testing.
namespace iotcloud::drivers::testing {

/// A driver host with simulated time: nothing happens until the test advances it. It records everything that the driver
/// does. Any thread may call publish, post, log, fail and update_metadata; only the test's thread calls the rest.
class MockHost final : public HostInterface {
 public:
  /// A message that publish() accepted.
  struct Published {
    std::string channel;
    Message message;  ///< with driver_id, gateway_id and time_ms filled in, as a real host does
  };
  /// A line that the driver logged.
  struct Logged {
    LogLevel level;
    std::string text;
  };

  explicit MockHost(PropertyMap properties = {}) : properties_(std::move(properties)) {}

  // Called by the driver.
  const std::string& instance_id() const noexcept override { return instance_id_; }
  const std::string& gateway_id() const noexcept override { return gateway_id_; }
  const PropertyMap& properties() const noexcept override { return properties_; }
  PublishStatus publish(std::string_view channel, Message message) noexcept override;
  HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                        std::function<void()> callback) noexcept override;
  HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept override;
  void stop_handler(HandlerId id) noexcept override;
  void post(std::function<void()> callback) noexcept override;
  void log(LogLevel level, std::string_view text) noexcept override;
  void fail(std::string_view reason) noexcept override;
  void update_metadata(const PropertyMap& changes) noexcept override;
  void report_found(std::string_view key, const PropertyMap& attributes) noexcept override;
  void report_gone(std::string_view key) noexcept override;
  void report_sight(bool sees) noexcept override;

  // Called by the test.
  /// Advances time: runs posted callbacks and every timer that falls due, in order of time.
  void advance(std::chrono::microseconds duration);
  /// Runs posted callbacks, and those that they post, about `limit` of them at most (so that a driver that posts for
  /// ever does not hang the test). \return how many ran.
  std::size_t run_posted(std::size_t limit = 1'000'000);
  /// Waits up to `limit` of real time for a watched descriptor and runs the callbacks of those that are ready.
  /// \return how many ran.
  std::size_t poll_descriptors(std::chrono::milliseconds limit);
  /// The channels that publish() knows: on any other it answers `closed` and fails the instance, as a real host does.
  /// MockInstance calls it; without a call every channel is known.
  void declare_channels(std::vector<ChannelSpec> channels);
  /// Sets what publish() answers on a channel from now on. Only accepted messages are recorded.
  void answer_publish(const std::string& channel, PublishStatus status);
  /// Called for each accepted message from inside publish(); to close a loop, post() from it.
  void on_publish(std::function<void(const Published&)> callback) { on_publish_ = std::move(callback); }
  /// Forgets all timers, watches and posted callbacks, as a host does when the instance is closed.
  void drop_handlers();

  // What the test checks.
  std::chrono::microseconds now() const { return now_; }  ///< simulated, from 0
  std::vector<Published> published() const;
  std::vector<Published> published(std::string_view channel) const;
  void forget_published();
  std::vector<Logged> logged() const;
  /// How many log lines contain this text.
  std::size_t logged_count(std::string_view text) const;
  PropertyMap metadata() const;  ///< all that the driver has set so far
  /// All that the driver, a finder, has found and that is not gone: attributes by key.
  std::map<std::string, PropertyMap> found() const;
  bool sees() const;  ///< what the finder said last with report_sight()
  bool failed() const;
  std::string failure() const;  ///< the first reason given to fail(); empty when there was none

 private:
  struct Timer {
    std::chrono::microseconds due, period;
    std::function<void()> callback;
  };
  struct Watch {
    int descriptor;
    bool for_writing;
    std::function<void()> callback;
  };

  const PropertyMap properties_;
  const std::string instance_id_ = "0123456789abcdef0123456789abcdef";
  const std::string gateway_id_ = "test-gateway";
  std::function<void(const Published&)> on_publish_;
  std::chrono::microseconds now_{0};
  HandlerId next_id_ = 1;
  std::map<HandlerId, Timer> timers_;
  std::map<HandlerId, Watch> watches_;

  mutable config::Mutex mutex_;
  std::vector<std::function<void()>> posted_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<Published> published_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<Logged> logged_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::string, PublishStatus, std::less<>> answers_ IOTCLOUD_GUARDED_BY(mutex_);
  std::optional<std::vector<ChannelSpec>> channels_ IOTCLOUD_GUARDED_BY(mutex_);  ///< nullopt: nothing was declared
  PropertyMap metadata_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::string, PropertyMap> found_ IOTCLOUD_GUARDED_BY(mutex_);
  bool sees_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::string failure_ IOTCLOUD_GUARDED_BY(mutex_);
  bool failed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

/// One instance of a driver in a MockHost, called through its plugin's descriptor as a real host does: no call throws,
/// and error() has what the driver threw.
///
///     MockInstance robot(describe<TurtleDriver>("turtle", "1", true), {{"seed", "7"}});
///     robot.start();
///     robot.host().advance(100ms);
///     EXPECT_EQ(robot.host().published("kinect").size(), 3);
class MockInstance {
 public:
  /// \param properties of the deployment; open() checks them against those that the driver declares, and the driver
  /// gets the defaults that it declared.
  explicit MockInstance(const Descriptor& descriptor, PropertyMap properties = {});
  /// Closes the instance if it is open.
  ~MockInstance();
  MockInstance(const MockInstance&) = delete;
  MockInstance& operator=(const MockInstance&) = delete;

  /// Calls channels, open and activate. \return whether all succeeded.
  bool start();
  bool open();  ///< channels and open only
  bool activate();
  bool deactivate();
  /// Gives the driver a message from an incoming channel, then runs what the driver posted. These three calls throw
  /// std::invalid_argument for a channel that the open instance has not declared.
  bool deliver(std::string_view channel, Message message);
  bool writable(std::string_view channel);
  bool stored(std::string_view channel, std::uint64_t count);
  void close();

  MockHost& host() { return host_; }
  const std::vector<ChannelSpec>& channels() const { return channels_; }
  /// The text of the first exception that the driver threw; empty when it threw none.
  const std::string& error() const { return error_; }

 private:
  bool note(const std::string& error);
  void require(std::string_view channel, Direction direction) const;
  Descriptor descriptor_;
  MockHost host_;
  DriverShell* shell_;
  std::vector<ChannelSpec> channels_;
  std::string error_;
  bool opened_ = false;
};

}  // namespace iotcloud::drivers::testing
