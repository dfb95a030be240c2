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
/// Text by name: a deployment's properties, or an instance's metadata.
using PropertyMap = std::map<std::string, std::string>;

/// A channel's direction as seen from the driver: messages of an `out` channel go from the driver to the broker.
enum class Direction { in, out };

/// The policies of publish() on an outgoing channel whose queue is full: the broker is away or slow, or has no reader
/// yet.
enum class WhenFull {
  keep_newest,  ///< drops the oldest waiting message (frames: a stale one is worse than none)
  block,        ///< publish() answers would_block (readings: a lost one is worse than a late one)
  spool,        ///< writes each message to disk first, see Spool (readings that must survive a restart of the device)
};

/// The bounded log on disk of a channel with WhenFull::spool. A message that publish() accepted stays in it until the
/// broker has confirmed the message, even when the driver host, the gateway or the broker dies. After a restart the
/// instance sends the log's messages first.
struct Spool {
  /// When the host syncs messages to the disk. This matters only if the machine loses power. publish() never waits for
  /// the disk; the host calls Driver::on_stored for messages that are safe.
  enum class Fsync {
    never,     ///< the operating system decides; the host does not call on_stored
    interval,  ///< ten times a second
    always,    ///< at once: each sync covers all messages that were published since the last one
  };
  /// What happens when `bytes` are used up.
  enum class Full {
    block,        ///< publish() answers would_block
    drop_oldest,  ///< publish() drops and counts the oldest messages
  };
  std::uint64_t bytes = std::uint64_t{256} << 20;  ///< most bytes on disk
  Fsync fsync = Fsync::interval;
  Full full = Full::block;
};

/// One channel that a driver wants. The gateway's configuration and `deploy --property` may override the quality of
/// service: "channel.<name>.capacity", ".when_full", ".deadline_ms", ".durable", ".broker", ".shared", ".priority",
/// ".interop", ".spool_bytes", ".spool_fsync", ".spool_full".
struct ChannelSpec {
  std::string name;  ///< unique in the driver; 1 to 200 characters without slash and control characters
  Direction direction = Direction::out;
  std::string broker;    ///< logical broker name of the gateway; empty: its first one
  bool shared = false;   ///< one topic for all instances of this driver on the gateway (docs/wire.md#topics)
  bool durable = false;  ///< the broker keeps the channel's messages over its own restart
  WhenFull when_full = WhenFull::block;
  Spool spool;                            ///< with WhenFull::spool only
  std::size_t capacity = 1024;            ///< most messages that may wait in memory
  std::chrono::milliseconds deadline{0};  ///< older messages are dropped; 0 = none
  /// 0 to 9; the default is 4. Channels of priority 5 and higher (for commands) use connections of their own, so that
  /// their messages never wait behind bulk data.
  std::uint8_t priority = 4;
  std::size_t keep_last = 0;  ///< incoming channels: the driver gets only the newest N waiting messages; 0: all
  /// Names on the wire (docs/wire.md#topics): "exchange", "routingKey", "queueName" (RabbitMQ), "topic" (Kafka). A name
  /// that is missing is derived from those of gateway, driver and channel.
  PropertyMap properties;
};

/// Answer of publish(), which never blocks.
enum class PublishStatus {
  accepted,     ///< the host has it, and sends it until the broker has confirmed it
  would_block,  ///< the channel is full; Driver::on_writable follows
  /// The instance is being closed; or channels() did not declare such an outgoing channel, and the instance fails.
  closed,
};

/// How important a line of a driver's log is. The host writes those from its own level on.
enum class LogLevel { debug, info, warn, error };

/// Names a timer or a descriptor's watch, to stop it. Valid until stopped or until the instance closes.
using HandlerId = std::uint64_t;

/// The interface of the driver host to an instance. The host implements it, and mocks do in tests. The instance's event
/// thread may call everything; any thread may call publish, post, log, fail, update_metadata and those of finders. No
/// call throws. Callbacks run on the instance's event thread, never two at a time, and none after close() began.
class HostInterface {
 public:
  virtual ~HostInterface() = default;
  virtual const std::string& instance_id() const noexcept = 0;  ///< UUID without dashes
  virtual const std::string& gateway_id() const noexcept = 0;
  /// From the deployment, with the declared defaults of those that it does not give.
  virtual const PropertyMap& properties() const noexcept = 0;
  /// Fills in driver_id and gateway_id, and time_ms when it is 0. Never blocks.
  virtual PublishStatus publish(std::string_view channel, Message message) noexcept = 0;
  /// Calls `callback` after `first`, then every `period` (0: once). Times are counted from the start: a late call does
  /// not shift later ones.
  virtual HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                std::function<void()> callback) noexcept = 0;
  /// Runs `callback` while the descriptor is readable (or writable). The driver keeps the descriptor, and closes it.
  virtual HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept = 0;
  /// Does nothing for an id that is not there. No call of the callback begins after it returned.
  virtual void stop_handler(HandlerId id) noexcept = 0;
  /// Runs `callback` soon on the event thread. Thread safe.
  virtual void post(std::function<void()> callback) noexcept = 0;
  /// Writes a line to the host's log, with the instance's id. Thread safe.
  virtual void log(LogLevel level, std::string_view text) noexcept = 0;
  /// Closes this instance, whose state becomes `failed` with this reason. Thread safe.
  virtual void fail(std::string_view reason) noexcept = 0;
  /// Sets metadata that everybody can see and select the instance by (discovery/selection/README.md): `battery`,
  /// `location` ("39.17,-86.52": latitude and longitude), `position` ("3,4.5": x and y in metres), or any other key.
  /// Other keys keep their values; an empty value removes its key. A key set here overrides the deployment's. The host
  /// publishes a change at once, but waits 200 ms after the last one and then publishes all changes since: the registry
  /// is no channel for readings. The host refuses, and logs, an empty key and metadata of more than 16 KiB in all.
  /// Thread safe.
  virtual void update_metadata(const PropertyMap& changes) noexcept = 0;
  // These three are for finders: drivers that look for devices, of which a gateway's rules make instances
  // (gateway/provisioning/README.md). Without such rules nobody hears what they tell. Thread safe.
  /// Something was found, or is another than before. \param key names it, and nothing else that this instance finds, in
  /// 1 to 256 bytes. \param attributes what a rule may use, 1 to 64 of them with at most 16 KiB in all. The host
  /// refuses, and logs, more than that, and more than 10 000 things.
  virtual void report_found(std::string_view key, const PropertyMap& attributes) noexcept = 0;
  /// What was found under this key is there no longer.
  virtual void report_gone(std::string_view key) noexcept = 0;
  /// Whether this instance would see what is there now; false until it says so. While it does not see (its broker is
  /// away, say), nothing counts as gone. When it sees again, it tells all that it finds again: the rest is gone.
  virtual void report_sight(bool sees) noexcept = 0;
};

/// A driver's access to its host: HostInterface with shorter calls. It catches what a callback throws, on the plugin's
/// side of the border, and fails the instance. Lives as long as the driver.
class DriverContext {
 public:
  explicit DriverContext(HostInterface& host) : host_(host) {}

  // Identity and properties never change; the references live as long as the instance.
  const std::string& instance_id() const { return host_.instance_id(); }
  const std::string& gateway_id() const { return host_.gateway_id(); }
  const PropertyMap& properties() const { return host_.properties(); }
  /// These read a property as text or as a number. \throws std::invalid_argument naming the property when it is not a
  /// number.
  std::string property(const std::string& name, const std::string& fallback) const;
  double number(const std::string& name, double fallback) const;
  std::int64_t integer(const std::string& name, std::int64_t fallback) const;
  /// The same of properties that the driver declares (declaration.h) with a default, or as required: the host has
  /// checked them. \throws std::invalid_argument naming the property when it is missing.
  std::string property(const std::string& name) const;
  double number(const std::string& name) const;
  std::int64_t integer(const std::string& name) const;
  bool flag(const std::string& name) const { return property(name) == "true"; }

  /// Sends on an outgoing channel: HostInterface::publish(). Takes the message over, never blocks. Thread safe.
  PublishStatus publish(std::string_view channel, Message message) {
    return host_.publish(channel, std::move(message));
  }
  /// The same, without properties, and with the present time.
  PublishStatus publish(std::string_view channel, Payload payload) {
    Message message;
    message.payload = std::move(payload);
    return host_.publish(channel, std::move(message));
  }
  /// Calls back every `period`, first after one period. On the event thread, as the callbacks below.
  HandlerId every(std::chrono::microseconds period, std::function<void()> callback);
  /// Calls back once.
  HandlerId after(std::chrono::microseconds delay, std::function<void()> callback);
  /// Calls back while the descriptor, which stays the driver's, is readable. Stop it before you close the descriptor.
  HandlerId on_readable(int descriptor, std::function<void()> callback);
  /// The same while it is writable.
  HandlerId on_writable(int descriptor, std::function<void()> callback);
  /// Stops a timer or a watch: HostInterface::stop_handler().
  void stop(HandlerId id) { host_.stop_handler(id); }
  /// Runs the callback soon on the event thread. Thread safe: the way back from a driver's own threads.
  void post(std::function<void()> callback);
  /// Thread safe.
  void log(LogLevel level, std::string_view text) { host_.log(level, text); }
  /// Closes this instance, whose state becomes `failed`. Thread safe.
  void fail(std::string_view reason) { host_.fail(reason); }
  /// HostInterface::update_metadata(). Thread safe.
  void update_metadata(const PropertyMap& changes) { host_.update_metadata(changes); }
  /// For finders: HostInterface::report_found(). Thread safe.
  void report_found(std::string_view key, const PropertyMap& attributes) { host_.report_found(key, attributes); }
  /// HostInterface::report_gone(). Thread safe.
  void report_gone(std::string_view key) { host_.report_gone(key); }
  /// HostInterface::report_sight(). Thread safe.
  void report_sight(bool sees) { host_.report_sight(sees); }

 private:
  std::function<void()> guarded(std::function<void()> callback);
  HostInterface& host_;
};

/// One driver instance, written by the user. The instance's event thread makes all calls, one at a time. An exception
/// fails this instance and no other. Order of calls: channels, open, (activate, deactivate)*, close, destructor.
class Driver {
 public:
  virtual ~Driver() = default;
  /// The channels this instance wants, given its properties: those of HostInterface::properties().
  virtual std::vector<ChannelSpec> channels(const PropertyMap& properties) = 0;
  /// Connects to the device. `context` lives until after the destructor.
  virtual void open(DriverContext& context) = 0;
  virtual void activate() {}    ///< starts to produce messages
  virtual void deactivate() {}  ///< stops producing; timers and watches that the driver does not stop go on
  /// Releases the device; called after a failure too. No callback runs any more. A driver must end its own threads
  /// here.
  virtual void close() {}
  /// Receives a message from an incoming channel, also while inactive.
  // NOLINTNEXTLINE(performance-unnecessary-value-param): an override may keep the message.
  virtual void on_message(std::string_view channel, Message message) { (void)channel, (void)message; }
  /// The channel takes messages again, after publish() had answered would_block.
  virtual void on_writable(std::string_view channel) { (void)channel; }
  /// The first `count` messages that this instance published on a channel with WhenFull::spool, and publish() accepted,
  /// are safe from a loss of power: each is on the disk, the broker has confirmed it, or the channel's policy dropped
  /// it. `count` rises; one call reports many messages. A driver whose device deletes acknowledged data acknowledges it
  /// here.
  virtual void on_stored(std::string_view channel, std::uint64_t count) { (void)channel, (void)count; }
};

}  // namespace iotcloud::drivers
