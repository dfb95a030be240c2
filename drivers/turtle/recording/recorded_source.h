#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/recording/recording.h>

namespace iotcloud::drivers::turtle::recording {

struct PlaybackOptions {
  std::string path;
  bool loop = true;
  double speed = 1;                     ///< 2 plays twice as fast as recorded
  std::chrono::microseconds period{0};  ///< frames that come sooner than this after the last one are left out
};

/// The kind `recording`; README.md lists its properties.
DeviceKind recording_kind();

/// Plays a recording at its own pace, from its beginning at each start(). A file that cannot be read fails the
/// instance.
class RecordedSource final : public DepthSource {
 public:
  /// \throws std::runtime_error if there is no recording.
  RecordedSource(const PlaybackOptions& options, DriverContext& context);
  ~RecordedSource() override { stop(); }

  void start(std::function<void(const DepthFrame&)> on_frame) override;
  void stop() override;

 private:
  void play();

  const PlaybackOptions options_;
  DriverContext& context_;
  const Recording recording_;
  std::vector<std::uint16_t> disparities_;
  std::size_t next_ = 0;
  std::chrono::microseconds played_{0}, last_sent_{0};  ///< of the recording's time
  std::function<void(const DepthFrame&)> on_frame_;     ///< empty while stopped
  std::optional<HandlerId> timer_;
};

}  // namespace iotcloud::drivers::turtle::recording
