#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>
#include <iotcloud/drivers/stream/frame_link.h>
#include <iotcloud/drivers/stream/framing.h>

namespace iotcloud::drivers::stream {

/// The properties that all drivers of frames have. \param framing the default of `framing`
constexpr auto stream_properties(std::string_view framing) {
  return joined(std::array{stream::broker_property}, framing_properties(framing));
}

/// Those of a driver that looks for its device again when it is away.
inline constexpr std::array connecting_properties{
    PropertySpec{.name = "frame_limit_ms",
                 .type = PropertyType::integer,
                 .unit = "ms",
                 .min = 0,
                 .max = 600'000,
                 .default_value = "0",
                 .text = "a frame whose end has not come for this long is forgotten; 0: never"},
    PropertySpec{.name = "unsent_bytes",
                 .type = PropertyType::integer,
                 .unit = "bytes",
                 .min = 1,
                 .max = 64 << 20,
                 .default_value = "1048576",
                 .text = "most that waits for the device; commands beyond are lost"},
    PropertySpec{.name = "while_away",
                 .default_value = "drop",
                 .choices = {"drop", "keep"},
                 .text = "commands for a device that is away: drop them, or keep as many as unsent_bytes"},
    reconnect_ms,
    reconnect_most_ms,
};

/// What drivers of frames have in common: a frame of the device becomes a message on `received`, and a message on
/// `send` a frame. Metadata say whether the device is there: `connection` is `connected` or `away`, and
/// `connection_problem` says why.
class StreamDriver : public Driver {
 public:
  static constexpr std::string_view received_channel = "received";
  static constexpr std::string_view send_channel = "send";
  /// The property of a message that names the peer, where there are several.
  static constexpr std::string_view peer_property = "peer";

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 protected:
  /// Reads the driver's own properties; channels() calls it. \throws std::invalid_argument
  virtual void read(PropertyReader& reader) = 0;
  /// Looks for the device; open() calls it.
  virtual void connect() = 0;
  /// Sends bytes that are framed. \return why it cannot; empty: it does
  virtual std::string send(const std::string& bytes, const Message& message) = 0;
  /// Frames can be published again.
  virtual void resume() = 0;

  DriverContext& context() { return *context_; }
  const FramingOptions& framing() const { return framing_; }
  /// \return false: the channel is full; resume() follows
  bool publish(const Payload& frame, std::string_view peer = {});
  void tell_connected(const PropertyMap& more = {}) { state_->connected(more); }
  void tell_away(const std::string& reason) { state_->away(reason); }
  void lose(const std::string& what, const std::string& why);

 private:
  DriverContext* context_ = nullptr;
  FramingOptions framing_;
  std::string broker_;
  bool active_ = false, blocked_ = false;
  std::optional<DeviceState> state_;
  std::optional<RareLog> lost_;
};

/// A driver whose device is at the other end of one connection, and which makes that connection anew when it has ended.
class ConnectingDriver : public StreamDriver {
 public:
  void open(DriverContext& context) override;
  void close() override;

 protected:
  void read(PropertyReader& reader) override;
  std::string send(const std::string& bytes, const Message& message) override;
  void resume() override;

  /// The connection is there: reads and writes these descriptors, which are the link's from now on.
  void connected(int input, int output, const PropertyMap& metadata = {});
  /// There is none, or it has ended: calls connect() after a pause.
  void away(const std::string& reason);
  /// The link has ended, and is gone; away() unless the driver has something else to do.
  virtual void ended(const std::string& reason) { away(reason); }
  bool has_link() const { return link_ != nullptr; }
  void drop_link() { link_.reset(); }
  const FrameLink::Options& link_options() const { return options_; }
  /// A connection on which nothing comes for this long is ended; 0: none.
  void set_silence(std::chrono::milliseconds silence) { options_.silence = silence; }
  std::chrono::milliseconds longest_pause() const { return pauses_.most; }

 private:
  FrameLink::Options options_;
  bool keeps_ = false;
  ReconnectPauses pauses_;
  std::optional<Retry> retry_;
  std::unique_ptr<FrameLink> link_;
  std::deque<std::string> waiting_;  ///< for a device that is away
  std::size_t waiting_bytes_ = 0;
};

}  // namespace iotcloud::drivers::stream
