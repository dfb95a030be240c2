#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/drivers/camera/options.h>
#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers::camera {

/// A picture, or the next part of an H.264 stream: an access unit with start codes.
struct Frame {
  Payload payload;
  int width = 0, height = 0;                ///< pixels
  bool key = true;                          ///< it can be decoded without those before it
  std::optional<std::int64_t> position_ms;  ///< since the stream, or the file, began
  std::int64_t time_ms = 0;                 ///< when it was captured, since 1970; 0: a file's, which nobody knows
};

/// A camera that is open, by GStreamer, whose headers this one hides. The instance's event thread makes all calls;
/// GStreamer has threads of its own, and waits for take() when four frames wait.
class Pipeline {
 public:
  struct Handlers {
    std::function<void()> on_frames;  ///< frames wait for take()
    /// The camera is gone, the file has ended, or neither could be opened: `failed` and why. Called once, as the last.
    std::function<void(bool failed, const std::string& reason)> on_end;
  };
  /// Begins to open the camera. Handlers are called on the event thread, never from inside a call, and not after the
  /// destructor, which they may call. \throws std::runtime_error when GStreamer lacks an element
  Pipeline(DriverContext& context, const Options& options, Handlers handlers);
  ~Pipeline();
  Pipeline(const Pipeline&) = delete;
  Pipeline& operator=(const Pipeline&) = delete;

  /// The next frame; nullopt: none waits now.
  std::optional<Frame> take();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::drivers::camera
