#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/camera/options.h>
#include <iotcloud/drivers/camera/pipeline.h>
#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::camera {

/// A camera: README.md.
class CameraDriver : public Driver {
 public:
  static constexpr std::string_view frames_channel = "frames";
  // Properties of a message.
  static constexpr std::string_view format_property = "format", width_property = "width", height_property = "height",
                                    position_property = "position_ms", key_property = "key";
  static constexpr std::string_view description =
      "A camera (V4L2, RTSP), a video file or a test picture: JPEG or H.264 frames as messages";
  static constexpr std::array declared_properties{
      PropertySpec{
          .name = "source", .required = true, .text = "v4l2:/dev/video0, rtsp://HOST[:554]/PATH, file:/PATH, test"},
      PropertySpec{.name = "format", .default_value = "jpeg", .choices = {"jpeg", "h264"}, .text = "of frames"},
      PropertySpec{.name = "rate",
                   .type = PropertyType::number,
                   .unit = "frames/s",
                   .min = 0,
                   .max = 1000,
                   .default_value = "0",
                   .text = "most frames; 0: all"},
      PropertySpec{.name = "width",
                   .type = PropertyType::integer,
                   .unit = "pixels",
                   .min = 0,
                   .max = 16'384,
                   .default_value = "0",
                   .text = "larger pictures are made smaller, in their proportions; 0: any width"},
      PropertySpec{.name = "height",
                   .type = PropertyType::integer,
                   .unit = "pixels",
                   .min = 0,
                   .max = 16'384,
                   .default_value = "0",
                   .text = "the same"},
      PropertySpec{.name = "quality",
                   .type = PropertyType::integer,
                   .min = 1,
                   .max = 100,
                   .default_value = "80",
                   .text = "jpeg: of what is encoded"},
      PropertySpec{.name = "bitrate_kbps",
                   .type = PropertyType::integer,
                   .unit = "kbit/s",
                   .min = 1,
                   .max = 1'000'000,
                   .default_value = "1000",
                   .text = "h264: of what is encoded"},
      stream::most_bytes_property("of a frame; a longer one is left out"),
      PropertySpec{.name = "loop",
                   .type = PropertyType::flag,
                   .default_value = "false",
                   .text = "file: from its beginning again at its end"},
      PropertySpec{.name = "transport", .default_value = "tcp", .choices = {"tcp", "udp"}, .text = "rtsp"},
      PropertySpec{.name = "latency_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 0,
                   .max = 60'000,
                   .default_value = "200",
                   .text = "rtsp: how long packets that came in another order are waited for"},
      PropertySpec{.name = "user", .text = "rtsp: none"},
      PropertySpec{.name = "password_file", .text = "rtsp: file whose first line is the password"},
      PropertySpec{.name = "silence_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 0,
                   .max = 600'000,
                   .default_value = "10000",
                   .text = "a camera that sends no frame for this long is opened anew; 0: never"},
      stream::reconnect_ms,
      stream::reconnect_most_ms,
      stream::broker_property,
  };

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_writable(std::string_view channel) override;

 private:
  void connect();
  void disconnect();
  void ended(bool failed, const std::string& reason);
  void take_frames();
  void take(Frame frame);
  /// \return false: the channel is full
  bool publish(const Frame& frame);
  void tick();

  DriverContext* context_ = nullptr;
  Options options_;
  std::optional<stream::DeviceState> state_;
  std::optional<stream::Retry> retry_;
  std::optional<stream::RareLog> too_long_, left_out_;
  std::unique_ptr<Pipeline> pipeline_;
  std::optional<Frame> waiting_;  ///< the channel is full
  bool active_ = false, full_ = false;
  bool heard_ = false;      ///< a frame has come since the camera was opened
  bool at_end_ = false;     ///< of the file, but for the frame that waits
  bool needs_key_ = false;  ///< H.264: a frame was left out, so those up to the next key frame mean nothing
  int width_ = 0, height_ = 0;
  int silent_ticks_ = 0;
  std::optional<HandlerId> ticks_;
};

}  // namespace iotcloud::drivers::camera
