#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/brokers/message.h>

/// The driver SDK: what a driver's author includes, together with <iotcloud/drivers/plugin.h> for the export macro.
namespace iotcloud::drivers {

using brokers::Message;
using brokers::Payload;
using PropertyMap = std::map<std::string, std::string>;

enum class Direction { in, out };  ///< seen from the driver: out = to the cloud

/// What happens on an outgoing channel when the broker is away, slow, or nobody reads yet.
enum class WhenFull {
  keep_newest,  ///< drop the oldest that waits (frames: stale is worse than none)
  block,        ///< publish() answers would_block (readings: lost is worse than late)
  spool,        ///< write it to disk first, see Spool (readings that must survive the device's own restart too)
};

/// The bounded log on disk of a channel with WhenFull::spool. What publish() accepted is in it until the broker has it,
/// whatever happens to driver host, gateway or broker meanwhile; a later life of the instance sends it first.
struct Spool {
  /// When it is on the disk for good; needed against a loss of power only.
  enum class Fsync {
    never,     ///< when the operating system does it
    interval,  ///< ten times a second
    always,    ///< before publish() returns, which therefore waits for the disk
  };
  enum class Full {
    block,        ///< publish() answers would_block
    drop_oldest,  ///< the oldest give way, and are counted
  };
  std::uint64_t bytes = std::uint64_t{256} << 20;  ///< at most, on disk
  Fsync fsync = Fsync::interval;
  Full full = Full::block;
};

/// One channel that a driver wants. The gateway's configuration and `deploy --property` may override the quality of
/// service: "channel.<name>.capacity", ".when_full", ".deadline_ms", ".durable", ".broker", ".shared", ".priority",
/// ".interop", ".spool_bytes", ".spool_fsync", ".spool_full".
struct ChannelSpec {
  std::string name;
  Direction direction = Direction::out;
  std::string broker;   ///< logical broker name of the gateway; empty: its first one
  bool shared = false;  ///< one topic for all instances of this driver on the gateway (REFERENCE.md 3)
  bool durable = false;
  WhenFull when_full = WhenFull::block;
  Spool spool;                            ///< with WhenFull::spool only
  std::size_t capacity = 1024;            ///< messages that may wait (in memory)
  std::chrono::milliseconds deadline{0};  ///< older messages are dropped; 0 = none
  /// 0 to 9, 4 is usual. From 5 on (control channels) its messages have connections of their own and never wait behind
  /// bulk data.
  std::uint8_t priority = 4;
  std::size_t keep_last = 0;  ///< in: hand on only the newest N of what waits; 0 = all
  /// REFERENCE.md 3: "exchange", "routingKey", "queueName" (RabbitMQ), "topic" (Kafka). Missing ones are made from
  /// names.
  PropertyMap properties;
};

enum class PublishStatus {
  accepted,
  would_block,  ///< the channel is full; Driver::on_writable follows
  closed,       ///< the instance is being closed, or there is no such outgoing channel
};

enum class LogLevel { debug, info, warn, error };

/// Stops a timer or a descriptor's watch. Valid until stopped or the instance closes.
using HandlerId = std::uint64_t;

/// What the driver host gives an instance. Implemented by the host (and by mocks in tests). Everything may be called
/// from the instance's event thread; publish, post, log, fail and update_metadata from any thread. No call throws.
/// Callbacks run on the instance's event thread, never two at a time, and none after close() began.
class HostInterface {
 public:
  virtual ~HostInterface() = default;
  virtual const std::string& instance_id() const noexcept = 0;  ///< UUID without dashes
  virtual const std::string& gateway_id() const noexcept = 0;
  virtual const PropertyMap& properties() const noexcept = 0;  ///< from the deployment
  /// Fills driver_id and gateway_id; time_ms too when it is 0. Never blocks.
  virtual PublishStatus publish(std::string_view channel, Message message) noexcept = 0;
  /// First call after `first`, then each `period` (0: once), from intended times: a late call does not shift later
  /// ones.
  virtual HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                std::function<void()> callback) noexcept = 0;
  /// The callback runs when the descriptor is readable (or writable). The descriptor stays the driver's.
  virtual HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept = 0;
  virtual void stop_handler(HandlerId id) noexcept = 0;
  /// Runs the callback on the event thread soon. Thread safe.
  virtual void post(std::function<void()> callback) noexcept = 0;
  virtual void log(LogLevel level, std::string_view text) noexcept = 0;
  /// This instance cannot go on: it is closed and its state becomes `failed` with this reason. Thread safe.
  virtual void fail(std::string_view reason) noexcept = 0;
  /// What everybody can see of this instance, and choose it by (discovery/selection/README.md): `battery`, `location`
  /// ("39.17,-86.52": latitude and longitude), `position` ("3,4.5": x and y in metres), or any other key. Keys that are
  /// not named stay as they are; an empty value takes the key away. Goes before what the deployment says of the same
  /// key. Published at once, and again after 200 ms at the soonest, with all that was said meanwhile: the registry is
  /// no channel for readings. Metadata beyond 16 KiB in all, or an empty key, is refused, which is logged. Thread safe.
  virtual void update_metadata(const PropertyMap& changes) noexcept = 0;
};

/// What a driver works with: HostInterface with the comfort of the SDK. An exception from a callback is caught here, on
/// the plugin's side of the border, and fails the instance. Lives as long as the driver.
class DriverContext {
 public:
  explicit DriverContext(HostInterface& host) : host_(host) {}

  const std::string& instance_id() const { return host_.instance_id(); }
  const std::string& gateway_id() const { return host_.gateway_id(); }
  const PropertyMap& properties() const { return host_.properties(); }
  /// A property as text or a number. \throws std::invalid_argument naming the property when it is not a number.
  std::string property(const std::string& name, const std::string& fallback) const;
  double number(const std::string& name, double fallback) const;
  std::int64_t integer(const std::string& name, std::int64_t fallback) const;

  PublishStatus publish(std::string_view channel, Message message) {
    return host_.publish(channel, std::move(message));
  }
  PublishStatus publish(std::string_view channel, Payload payload) {
    Message message;
    message.payload = std::move(payload);
    return host_.publish(channel, std::move(message));
  }
  HandlerId every(std::chrono::microseconds period, std::function<void()> callback);
  HandlerId after(std::chrono::microseconds delay, std::function<void()> callback);
  HandlerId on_readable(int descriptor, std::function<void()> callback);
  HandlerId on_writable(int descriptor, std::function<void()> callback);
  void stop(HandlerId id) { host_.stop_handler(id); }
  void post(std::function<void()> callback);
  void log(LogLevel level, std::string_view text) { host_.log(level, text); }
  void fail(std::string_view reason) { host_.fail(reason); }
  void update_metadata(const PropertyMap& changes) { host_.update_metadata(changes); }

 private:
  std::function<void()> guarded(std::function<void()> callback);
  HostInterface& host_;
};

/// One driver instance, written by the user. All calls come from the instance's event thread, one at a time. An
/// exception fails this instance and no other. Calls in order: channels, open, (activate, deactivate)*, close,
/// destructor.
class Driver {
 public:
  virtual ~Driver() = default;
  /// The channels this instance wants, given its properties.
  virtual std::vector<ChannelSpec> channels(const PropertyMap& properties) = 0;
  /// Connects to the device. `context` lives until after the destructor.
  virtual void open(DriverContext& context) = 0;
  virtual void activate() {}    ///< start to produce
  virtual void deactivate() {}  ///< stop to produce; timers and watches that the driver left running go on
  virtual void close() {}
  /// A message came on an incoming channel (also while inactive).
  // NOLINTNEXTLINE(performance-unnecessary-value-param): who overrides this may keep the message.
  virtual void on_message(std::string_view channel, Message message) { (void)channel, (void)message; }
  /// An outgoing channel that had answered would_block takes messages again.
  virtual void on_writable(std::string_view channel) { (void)channel; }
};

}  // namespace iotcloud::drivers
