#include <algorithm>
#include <utility>

#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/simulator/simulated_robot.h>

namespace iotcloud::drivers::turtle::simulator {

using std::chrono::steady_clock;

DeviceKind simulator_kind() {
  DeviceKind kind;
  kind.name = "simulator";
  kind.source = kind.actuator = kind.pair_only = true;
  kind.read = [](PropertyReader& reader, const TurtleOptions& common, DeviceParts) -> DeviceMaker {
    SimulatorOptions options;
    options.period = common.period();
    options.seed = static_cast<std::uint64_t>(reader.integer("seed", 1, 0, INT64_MAX));
    options.lock_step = reader.choice("clock", "realtime", {"realtime", "lockstep"}) == "lockstep";
    options.retry = std::chrono::milliseconds(reader.integer("retry_ms", options.retry.count(), 10, 60'000));
    options.person_walks = reader.choice("person", "waits", {"waits", "walks"}) == "walks";
    return [options](DriverContext& context) {
      const auto robot = std::make_shared<SimulatedRobot>(options, context);
      return Device{robot, robot};
    };
  };
  return kind;
}

SimulatedRobot::SimulatedRobot(const SimulatorOptions& options, DriverContext& context)
    : context_(context),
      period_(options.period),
      retry_(options.retry),
      period_s_(std::chrono::duration<double>(period_).count()),
      lock_step_(options.lock_step),
      world_(options.seed),
      disparities_(depth::frame_pixels) {
  if (options.person_walks) world_.command({});  // the first command makes the person walk
}

void SimulatedRobot::start(std::function<void(const DepthFrame&)> on_frame) {
  stop();
  on_frame_ = std::move(on_frame);
  ++run_;
  if (lock_step_) {
    context_.post([this, run = run_] {
      if (run == run_ && on_frame_) next_frame();
    });
  } else {
    timer_ = context_.every(period_, [this] { next_frame(); });
  }
}

void SimulatedRobot::stop() {
  if (timer_) context_.stop(*timer_);
  timer_.reset();
  on_frame_ = nullptr;
}

void SimulatedRobot::next_frame() {
  const auto started = steady_clock::now();
  frame_started_ = started;
  world_.advance_to(frame_time(frame_++));
  world_.render(depth::FrameSpan(disparities_));
  truth_ = world_.truth();
  truth_.render_us = std::chrono::duration<double, std::micro>(steady_clock::now() - started).count();
  hand_over(false);
}

void SimulatedRobot::hand_over(bool repeated) {
  DepthFrame frame{depth::FrameView(disparities_), steady_clock::now(), world_.time(), repeated, &truth_};
  const auto on_frame = on_frame_;  // a copy: the callback may stop the source
  on_frame(frame);
  if (lock_step_ && on_frame_) wait_for_answer();
}

void SimulatedRobot::wait_for_answer() {
  if (timer_) context_.stop(*timer_);
  timer_ = context_.after(retry_, [this] { hand_over(true); });
}

void SimulatedRobot::answered() {
  if (!lock_step_ || !on_frame_) return;
  // Posted, because the driver is still handling the command that answers the frame.
  context_.post([this, run = run_, frame = frame_] {
    if (run == run_ && frame == frame_ && on_frame_) next_frame();
  });
}

void SimulatedRobot::catch_up() {
  // Between frames simulated time follows real time since the newest frame, but never past the next frame.
  if (lock_step_ || frame_ == 0 || !on_frame_) return;
  const double since = std::chrono::duration<double>(steady_clock::now() - frame_started_).count();
  world_.advance_to(frame_time(frame_ - 1) + std::min(since, period_s_));
}

void SimulatedRobot::drive(const Velocity& velocity) {
  catch_up();
  world_.command(velocity);
}

void SimulatedRobot::halt() {
  catch_up();
  world_.halt();
}

}  // namespace iotcloud::drivers::turtle::simulator
