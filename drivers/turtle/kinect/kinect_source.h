#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/kinect/camera.h>

namespace iotcloud::drivers::turtle::kinect {

struct KinectOptions {
  CameraSettings camera;
  std::chrono::microseconds period{0};       ///< frames that come sooner than this after the last one are left out
  std::chrono::milliseconds reconnect{500};  ///< before the first new attempt; doubles to 16 times that
  std::chrono::milliseconds silence{5000};   ///< a device that sends no frame for this long is opened again
};

/// The kind `kinect`; README.md lists its properties.
DeviceKind kinect_kind();

/// Depth frames of a Kinect through libfreenect, which runs on a thread of its own here: its replay sleeps in the call
/// that polls, and opening a device takes a second. The newest frame waits for the event thread and overwrites older
/// ones. The source looks for a missing device until stop(); the instance's metadata have `camera`: `connected` or
/// `absent`.
class KinectSource final : public DepthSource {
 public:
  KinectSource(const KinectOptions& options, DriverContext& context);
  ~KinectSource() override;

  void start(std::function<void(const DepthFrame&)> on_frame) override;
  /// Waits until the thread returns from libfreenect's current call.
  void stop() override;

  struct Counts {
    std::uint64_t frames = 0;      ///< frames from libfreenect
    std::uint64_t superseded = 0;  ///< frames that a newer one overwrote before the event thread took them
    std::uint64_t connects = 0;
    std::uint64_t lost = 0;    ///< connections that ended by themselves
    std::uint64_t failed = 0;  ///< failed attempts to connect
  };
  Counts counts() const;  ///< thread safe

 private:
  using Instant = std::chrono::steady_clock::time_point;
  void run();
  bool use_camera(bool& announced);
  std::uint16_t* take(std::uint32_t stamp);
  void hand_over();
  bool wait(std::chrono::milliseconds time);
  bool stopping() const;

  const KinectOptions options_;
  DriverContext& context_;
  // Used by the event thread only.
  std::function<void(const DepthFrame&)> on_frame_;  ///< empty while stopped
  std::vector<std::uint16_t> reading_;
  std::uint64_t run_ = 0;  ///< number of the last start(), so that callbacks of an earlier run do nothing
  /// a posted callback may outlive this object, and then does nothing
  const std::shared_ptr<const bool> alive_ = std::make_shared<const bool>(true);
  // Used by the camera's thread only.
  std::vector<std::uint16_t> filling_;
  std::uint32_t last_stamp_ = 0;
  double device_time_s_ = 0;
  Instant due_{}, last_frame_{};

  mutable std::mutex mutex_;  ///< guards what follows
  std::condition_variable stop_requested_;
  bool stop_ = false;
  struct Slot {
    std::vector<std::uint16_t> disparities;
    Instant captured;
    double device_time_s = 0;
    bool full = false;
  } newest_;
  Counts counts_;
  std::thread thread_;  ///< last, so that the members that it uses exist before it starts
};

}  // namespace iotcloud::drivers::turtle::kinect
