#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/stream/framing.h>

namespace iotcloud::drivers::stream {

/// An open connection to a device, over descriptors that never block: cuts what comes into frames and sends others. It
/// reads no further while its user cannot take a frame, so that the device waits, too. The instance's event thread
/// makes all calls.
class FrameLink {
 public:
  struct Handlers {
    /// false: it cannot be taken now, and comes again after resume().
    std::function<bool(const Payload&)> on_frame;
    std::function<void(const std::string&)> on_end;  ///< called once, with the reason; perhaps from inside resume()
  };
  struct Options {
    FramingOptions framing;
    /// A frame whose end has not come for this long is forgotten; 0: never.
    std::chrono::milliseconds frame_limit{0};
    /// The connection ends when nothing comes for this long; 0: never.
    std::chrono::milliseconds silence{0};
    std::size_t most_unsent = 1 << 20;  ///< bytes that wait for the device
  };
  /// Owns the descriptors, which may be the same, from now on. Handlers are not called after the destructor, and may
  /// destroy this object.
  FrameLink(DriverContext& context, int input, int output, Options options, Handlers handlers);
  ~FrameLink();
  FrameLink(const FrameLink&) = delete;
  FrameLink& operator=(const FrameLink&) = delete;

  /// Sends bytes, or keeps what the device does not take now. \return false: it keeps too much already, or takes
  /// nothing any more; these bytes are not sent
  bool send(const std::string& bytes);
  /// Call it when frames can be taken again.
  void resume();
  /// Frames that were left out because they are too long or malformed.
  std::uint64_t refused() const { return decoder_.refused(); }

 private:
  void watch_input();
  void read();
  bool hand_over();
  void write();
  void watch_unfinished();
  void tick();
  void end(const std::string& reason);

  DriverContext& context_;
  const int input_, output_;
  const Options options_;
  Handlers handlers_;
  FrameDecoder decoder_;
  std::optional<Payload> frame_;  ///< it could not be taken
  /// false: the connection has ended, or the object is destroyed
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);
  std::string unsent_;
  bool takes_ = true;  ///< whether writing has not failed
  int silent_ticks_ = 0;
  std::optional<HandlerId> readable_, writable_, unfinished_, ticks_;
};

}  // namespace iotcloud::drivers::stream
