#include <algorithm>
#include <utility>

#include <iotcloud/drivers/turtle/kinect/kinect_source.h>
#include <iotcloud/drivers/turtle/options.h>

namespace iotcloud::drivers::turtle::kinect {

using std::chrono::steady_clock;

namespace {

constexpr double ticks_per_second = 60e6;               // of the device's stamps
constexpr std::chrono::milliseconds poll_limit{20};     // the longest that stop() waits for the thread
constexpr std::chrono::milliseconds jitter_allowed{8};  // so that a rate of 30 Hz keeps every frame of a 30 Hz camera

}  // namespace

DeviceKind kinect_kind() {
  DeviceKind kind;
  kind.name = "kinect";
  kind.source = true;
  kind.read = [](PropertyReader& reader, const TurtleOptions& common, DeviceParts) -> DeviceMaker {
    KinectOptions options;
    options.period = common.period();
    options.camera.device = reader.text("device", options.camera.device);
    if (!reader.text("tilt", "").empty()) options.camera.tilt = reader.number("tilt", 0, -30, 30);
    if (!reader.text("led", "").empty()) options.camera.led = reader.choice("led", "", led_names());
    options.reconnect = std::chrono::milliseconds(reader.integer("reconnect_ms", options.reconnect.count(), 1, 60'000));
    options.silence = std::chrono::milliseconds(reader.integer("silence_ms", options.silence.count(), 200, 60'000));
    return [options](DriverContext& context) {
      return Device{std::make_shared<KinectSource>(options, context), nullptr};
    };
  };
  return kind;
}

KinectSource::KinectSource(const KinectOptions& options, DriverContext& context)
    : options_(options), context_(context), reading_(depth::frame_pixels), filling_(depth::frame_pixels) {
  newest_.disparities.resize(depth::frame_pixels);
}

KinectSource::~KinectSource() {
  stop();
}

void KinectSource::start(std::function<void(const DepthFrame&)> on_frame) {
  stop();
  on_frame_ = std::move(on_frame);
  ++run_;
  stop_ = false;
  newest_.full = false;
  due_ = {};
  thread_ = std::thread([this] { run(); });
}

void KinectSource::stop() {
  on_frame_ = nullptr;
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  stop_requested_.notify_all();
  thread_.join();
  const Counts counts = this->counts();
  context_.log(LogLevel::info, "kinect: " + std::to_string(counts.frames) + " frames, " +
                                   std::to_string(counts.superseded) + " superseded, " +
                                   std::to_string(counts.connects) + " connections, " + std::to_string(counts.lost) +
                                   " of them lost, " + std::to_string(counts.failed) + " attempts failed");
}

KinectSource::Counts KinectSource::counts() const {
  const std::lock_guard lock(mutex_);
  return counts_;
}

bool KinectSource::stopping() const {
  const std::lock_guard lock(mutex_);
  return stop_;
}

bool KinectSource::wait(std::chrono::milliseconds time) {
  std::unique_lock lock(mutex_);
  return !stop_requested_.wait_for(lock, time, [this] { return stop_; });
}

/// Runs on the camera's thread; no exception may leave it.
void KinectSource::run() {
  bool announced = false;  // the current problem was logged
  auto pause = options_.reconnect;
  do {
    if (use_camera(announced)) pause = options_.reconnect;
    if (stopping()) return;
    context_.update_metadata({{"camera", "absent"}});
  } while (wait(std::exchange(pause, std::min(2 * pause, 16 * options_.reconnect))));
}

/// Reads frames until the camera is gone or stop() is called. \return whether a frame came.
bool KinectSource::use_camera(bool& announced) {
  const auto warn = [this](const std::string& text) { context_.log(LogLevel::warn, text); };
  bool worked = false;
  try {
    Camera camera(
        options_.camera, filling_.data(), [this](std::uint32_t stamp) { return take(stamp); }, warn);
    {
      const std::lock_guard lock(mutex_);
      ++counts_.connects;
    }
    const auto opened = steady_clock::now();
    last_frame_ = opened;
    last_stamp_ = 0;
    while (!stopping()) {
      const bool alive = camera.poll(poll_limit);
      if (!worked && last_frame_ != opened) {
        worked = true;
        announced = false;
        context_.log(LogLevel::info, "the Kinect sends depth frames");
        context_.update_metadata({{"camera", "connected"}});
      }
      const bool silent = steady_clock::now() - last_frame_ > options_.silence;
      if (alive && !silent) continue;
      if (!std::exchange(announced, true)) {
        context_.log(LogLevel::error,
                     std::string(silent ? "no frame came from the Kinect for a while" : "the Kinect is gone") +
                         "; the driver looks for it until it is back");
      }
      const std::lock_guard lock(mutex_);
      ++counts_.lost;
      return worked;
    }
  } catch (const std::exception& e) {
    if (!std::exchange(announced, true)) {
      context_.log(LogLevel::error, std::string(e.what()) + ". The driver looks for it until it is there");
    }
    const std::lock_guard lock(mutex_);
    ++counts_.failed;
  }
  return worked;
}

std::uint16_t* KinectSource::take(std::uint32_t stamp) {
  const auto now = steady_clock::now();
  last_frame_ = now;
  // The stamp wraps round every 71 s. A device that is opened again continues the last one's time.
  if (last_stamp_ != 0) device_time_s_ += static_cast<std::uint32_t>(stamp - last_stamp_) / ticks_per_second;
  last_stamp_ = stamp;
  bool post = false;
  {
    const std::lock_guard lock(mutex_);
    ++counts_.frames;
    if (now + jitter_allowed < due_) return filling_.data();
    due_ = std::max(due_ + options_.period, now);
    std::swap(filling_, newest_.disparities);
    newest_.captured = now;
    newest_.device_time_s = device_time_s_;
    if (newest_.full) ++counts_.superseded;
    post = !std::exchange(newest_.full, true);  // if the slot was full, a callback is already posted
  }
  if (post) {
    context_.post([this, alive = std::weak_ptr(alive_), run = run_] {
      if (!alive.expired() && run == run_ && on_frame_) hand_over();
    });
  }
  return filling_.data();
}

void KinectSource::hand_over() {
  DepthFrame frame;
  {
    const std::lock_guard lock(mutex_);
    std::swap(reading_, newest_.disparities);
    frame.captured = newest_.captured;
    frame.device_time_s = newest_.device_time_s;
    newest_.full = false;
  }
  frame.disparities = depth::FrameView(reading_);
  const auto on_frame = on_frame_;  // a copy: the callback may stop the source
  on_frame(frame);
}

}  // namespace iotcloud::drivers::turtle::kinect
