#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <ostream>
#include <stdexcept>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <signal.h>
#include <time.h>

#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/recording/depth_statistics.h>
#include <iotcloud/drivers/turtle/recording/recorder.h>
#include <iotcloud/drivers/turtle/recording/recording.h>
#include <iotcloud/drivers/turtle/standalone/device_host.h>

namespace iotcloud::drivers::turtle::recording {

using std::chrono::steady_clock;

namespace {

std::string one_decimal(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f", value);
  return text;
}

/// Prints a line each second: "42 of 300 frames, 8.6 s left".
class Progress {
 public:
  Progress(std::ostream& out, std::string verb) : out_(out), verb_(std::move(verb)) {}
  /// \param left seconds; negative: unknown.
  void show(std::uint64_t frames, std::uint64_t of, double left) {
    const auto now = steady_clock::now();
    if (now - shown_ < std::chrono::seconds(1)) return;
    shown_ = now;
    out_ << verb_ << ' ' << frames;
    if (of > 0) out_ << " of " << of;
    out_ << " frames";
    if (left >= 0) out_ << ", " << one_decimal(left) << " s left";
    out_ << std::endl;
  }
  double seconds() const { return std::chrono::duration<double>(steady_clock::now() - begun_).count(); }

 private:
  std::ostream& out_;
  const std::string verb_;
  const steady_clock::time_point begun_ = steady_clock::now();
  steady_clock::time_point shown_ = begun_;
};

sigset_t stop_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  return signals;
}

/// Waits up to `seconds` for a signal that ends the work. \return whether one came.
bool stopped_within(double seconds) {
  const sigset_t signals = stop_signals();
  const auto whole = static_cast<time_t>(seconds);
  const timespec time{whole, static_cast<long>((seconds - static_cast<double>(whole)) * 1e9)};
  return sigtimedwait(&signals, nullptr, &time) > 0;
}

/// Takes frames from a source until it has enough.
class Recorder {
 public:
  Recorder(const RecordOptions& options, std::ostream& out)
      : options_(options), writer_(options.folder), progress_(out, "recorded") {}

  void run(const TurtleOptions& turtle, const PropertyMap& properties) {
    boost::asio::signal_set signals(loop_, SIGINT, SIGTERM);
    signals.async_wait([this](const boost::system::error_code& error, int) {
      if (!error) loop_.stop();
    });
    pthread_sigmask_guard unblocked;
    DeviceHost host(loop_, properties, log_to_stderr("iotcloud-record"), [this](const std::string& reason) {
      failure_ = reason;
      loop_.stop();
    });
    DriverContext context(host);
    const Device device = turtle.make_device(context);
    if (options_.seconds > 0) {
      context.after(std::chrono::microseconds(static_cast<std::int64_t>(options_.seconds * 1e6)),
                    [this] { loop_.stop(); });
    }
    device.source->start([&](const DepthFrame& frame) {
      take(frame);
      device.source->answered();  // so that a world in lock step goes on
    });
    loop_.run();
    device.source->stop();
    if (!failure_.empty()) throw std::runtime_error(failure_);
  }
  std::uint64_t frames() const { return writer_.frames(); }
  double seconds() const { return last_seconds_; }

 private:
  /// Unblocks the signals while the loop runs, so that they reach it.
  struct pthread_sigmask_guard {
    pthread_sigmask_guard() {
      const sigset_t signals = stop_signals();
      pthread_sigmask(SIG_UNBLOCK, &signals, &before);
    }
    ~pthread_sigmask_guard() { pthread_sigmask(SIG_SETMASK, &before, nullptr); }
    sigset_t before;
  };

  void take(const DepthFrame& frame) {
    if (options_.frames > 0 && writer_.frames() == options_.frames) return;
    if (!frame.disparities) {
      throw std::runtime_error(
          "this source sends frames that are compressed already: record on the machine that has the camera");
    }
    if (writer_.frames() == 0) {
      first_ = frame.captured;
      first_device_s_ = frame.device_time_s;
    }
    // A simulated world has its own time, the same in each run.
    last_seconds_ = frame.truth ? frame.device_time_s - first_device_s_
                                : std::chrono::duration<double>(frame.captured - first_).count();
    writer_.add(*frame.disparities, last_seconds_);
    double left = options_.seconds > 0 ? options_.seconds - progress_.seconds() : -1;
    if (options_.frames > 0) {
      const auto missing = static_cast<double>(options_.frames - writer_.frames());
      const double by_count = missing * progress_.seconds() / static_cast<double>(writer_.frames());
      left = left < 0 ? by_count : std::min(left, by_count);
    }
    progress_.show(writer_.frames(), options_.frames, left);
    if (writer_.frames() == options_.frames) loop_.stop();
  }

  const RecordOptions& options_;
  boost::asio::io_context loop_;
  RecordingWriter writer_;
  Progress progress_;
  steady_clock::time_point first_;
  double first_device_s_ = 0, last_seconds_ = 0;
  std::string failure_;
};

}  // namespace

void record(const RecordOptions& options, std::ostream& out) {
  PropertyMap properties = options.properties;
  properties["actuator"] = "none";
  const TurtleOptions turtle = read_options(properties, shipped_kinds());
  Recorder recorder(options, out);
  recorder.run(turtle, properties);
  if (recorder.frames() == 0) {
    throw std::runtime_error("no frame came, so there is no recording in " + options.folder.string());
  }
  out << recorder.frames() << " frames of " << one_decimal(recorder.seconds()) << " s in " << options.folder.string()
      << std::endl;
}

void play(const PlayOptions& options, std::ostream& out) {
  const Recording recording(options.folder);
  DepthStatistics statistics;
  std::vector<std::uint16_t> disparities(depth::frame_pixels);
  Progress progress(out, "played");
  const std::size_t count = recording.frames().size();
  double at = 0;  // seconds of the recording
  std::size_t played = 0;
  for (bool stopped = false; played < count && !stopped;) {
    recording.read(played, depth::FrameSpan(disparities));
    statistics.add(depth::FrameView(disparities));
    if (played + 1 < count) at += static_cast<double>(recording.interval_after(played).count()) / 1e6;
    ++played;
    progress.show(played, count, -1);
    stopped = stopped_within(options.speed > 0 ? std::max(0.0, at / options.speed - progress.seconds()) : 0);
  }
  out << played << " of " << count << " frames, " << one_decimal(at) << " s";
  if (played > 1 && at > 0) out << ", " << one_decimal(static_cast<double>(played - 1) / at) << " frames a second";
  out << "; " << statistics.text() << std::endl;
}

void import_images(const ImportOptions& options, std::ostream& out) {
  const auto files = find_images(options.from);
  std::vector<std::uint16_t> disparities(depth::frame_pixels);
  // Reads the first image before writing anything: most mistakes are in all images.
  read_image(files.front(), options.unit, depth::FrameSpan(disparities));
  RecordingWriter writer(options.folder);
  Progress progress(out, "imported");
  for (const auto& file : files) {
    if (stopped_within(0)) break;
    read_image(file, options.unit, depth::FrameSpan(disparities));
    writer.add(depth::FrameView(disparities), static_cast<double>(writer.frames()) / options.rate);
    const auto done = static_cast<double>(writer.frames());
    progress.show(writer.frames(), files.size(),
                  progress.seconds() * (static_cast<double>(files.size()) - done) / done);
  }
  out << writer.frames() << " of " << files.size() << " images are in " << options.folder.string() << std::endl;
}

}  // namespace iotcloud::drivers::turtle::recording
