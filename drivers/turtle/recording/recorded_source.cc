#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/recording/recorded_source.h>

namespace iotcloud::drivers::turtle::recording {

using std::chrono::microseconds;
using std::chrono::steady_clock;

namespace {

constexpr microseconds jitter_allowed{8000};  // so that a rate of 30 Hz keeps every frame of a 30 Hz recording

microseconds scaled(microseconds time, double factor) {
  return microseconds(std::llround(static_cast<double>(time.count()) * factor));
}

}  // namespace

DeviceKind recording_kind() {
  DeviceKind kind;
  kind.name = "recording";
  kind.source = true;
  kind.read = [](PropertyReader& reader, const TurtleOptions& common, DeviceParts) -> DeviceMaker {
    PlaybackOptions options;
    options.path = reader.text("path", "");
    options.loop = reader.flag("loop", options.loop);
    options.speed = reader.number("speed", options.speed, 0.01, 100);
    options.period = common.period();
    if (options.path.empty()) {
      throw std::invalid_argument("the source \"recording\" needs the property \"path\": a recording's folder");
    }
    return [options](DriverContext& context) {
      return Device{std::make_shared<RecordedSource>(options, context), nullptr};
    };
  };
  return kind;
}

RecordedSource::RecordedSource(const PlaybackOptions& options, DriverContext& context)
    : options_(options), context_(context), recording_(options.path), disparities_(depth::frame_pixels) {}

void RecordedSource::start(std::function<void(const DepthFrame&)> on_frame) {
  stop();
  on_frame_ = std::move(on_frame);
  next_ = 0;
  played_ = microseconds(0);
  last_sent_ = -options_.period;
  timer_ = context_.after(microseconds(0), [this] { play(); });
}

void RecordedSource::stop() {
  if (timer_) context_.stop(*timer_);
  timer_.reset();
  on_frame_ = nullptr;
}

void RecordedSource::play() {
  timer_.reset();
  const std::size_t frame = next_;
  const microseconds at = played_;
  const auto interval = scaled(recording_.interval_after(frame), 1 / options_.speed);
  played_ += interval;
  next_ = (frame + 1) % recording_.frames().size();
  if (next_ != 0 || options_.loop) {
    timer_ = context_.after(interval, [this] { play(); });  // set before the frame is read, which takes time
  }
  if (at - last_sent_ + jitter_allowed < options_.period) return;
  last_sent_ = std::max(last_sent_ + options_.period, at - options_.period);
  recording_.read(frame, depth::FrameSpan(disparities_));
  DepthFrame whole;
  whole.disparities = depth::FrameView(disparities_);
  whole.captured = steady_clock::now();
  whole.device_time_s = static_cast<double>(at.count()) / 1e6 * options_.speed;
  const auto on_frame = on_frame_;  // a copy: the callback may stop the source
  on_frame(whole);
}

}  // namespace iotcloud::drivers::turtle::recording
