#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <libfreenect.h>

namespace iotcloud::drivers::turtle::kinect {

struct CameraSettings {
  std::string device = "0";    ///< an index (below 100), or the serial number of the camera
  std::optional<double> tilt;  ///< degrees above the horizon, -30 to 30; nothing: the motor stays where it is
  std::string led;             ///< one of led_names(); empty: the light stays as it is
};

/// "off", "green", ...
const std::vector<std::string>& led_names();

/// One Kinect, opened through libfreenect and sending 11-bit depth. One thread owns and calls it; on_depth is called
/// inside poll() and the constructor.
class Camera {
 public:
  /// Called when the buffer holds a frame; the stamp counts the device's 60 MHz. \return the buffer of
  /// depth::frame_pixels values to fill next, which may be the same one.
  using OnDepth = std::function<std::uint16_t*(std::uint32_t stamp)>;

  /// \param buffer the first to fill. \param warn receives problems that do no harm (no motor, say).
  /// \throws std::runtime_error when there is no such device (the message lists the devices) or it cannot be opened.
  Camera(const CameraSettings& settings, std::uint16_t* buffer, OnDepth on_depth,
         const std::function<void(const std::string&)>& warn);
  ~Camera();
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;

  /// Waits about `limit` for frames (libfreenect's replay waits for the time of the next frame instead).
  /// \return false when the device is gone.
  bool poll(std::chrono::milliseconds limit);

 private:
  void open(const CameraSettings& settings);
  void set_up_motor(const CameraSettings& settings, const std::function<void(const std::string&)>& warn);
  void start(std::uint16_t* buffer);
  void close() noexcept;
  static void take_depth(freenect_device* device, void* depth, std::uint32_t stamp);

  OnDepth on_depth_;
  freenect_context* context_ = nullptr;
  freenect_device* device_ = nullptr;
};

}  // namespace iotcloud::drivers::turtle::kinect
