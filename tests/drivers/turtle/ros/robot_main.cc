// ros_robot: the simulated world of drivers/turtle/simulator as a ROS node, with the time-out of its base; until
// SIGTERM.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <iotcloud/drivers/turtle/simulator/world.h>
#include <iotcloud/tests/drivers/turtle/ros/robot_topics.h>

namespace {

namespace depth = iotcloud::drivers::depth;
using iotcloud::drivers::turtle::Velocity;
using iotcloud::drivers::turtle::simulator::World;
using std::chrono::steady_clock;

constexpr double frame_period_s = 1.0 / 30;
constexpr double step_s = 0.005;  // of real time
constexpr double rest_s = 0.01;   // lock step: between frames at the least, so that a rate of 120 Hz takes them all
constexpr double repeat_after_s = 0.5;  // lock step: a frame that nobody answers is sent again

double now_s() {
  return std::chrono::duration<double>(steady_clock::now().time_since_epoch()).count();
}

class Robot {
 public:
  Robot(std::uint64_t seed, const std::string& trace)
      : world_(seed),
        disparities_(depth::frame_pixels),
        mm_(depth::frame_pixels),
        topics_([this](double linear, double angular) {
          obey({linear, angular});
        }) {
    trace_ = std::fopen((trace + ".new").c_str(), "w");
    if (trace_ == nullptr) throw std::runtime_error("cannot write " + trace);
    std::fputs("time_s,commands,asked_linear,asked_angular,linear,angular,x,y,distance,in_box\n", trace_);
    note();
    std::rename((trace + ".new").c_str(), trace.c_str());  // its existence shows that this process is ready
  }

  /// Moves the world at the clock's pace.
  void run_real_time() {
    const double begin = now_s();
    double next_frame = 0;
    while (topics_.spin(step_s)) {
      world_.advance_to(now_s() - begin);
      note();
      if (world_.time() < next_frame) continue;
      next_frame = std::max(next_frame + frame_period_s, world_.time() - frame_period_s);
      show();
    }
  }

  /// Moves the world one frame further when a frame was answered, and waits until it is read.
  void run_lock_step() {
    double sent = 0;
    std::uint64_t answered = commands_;
    while (topics_.spin(step_s)) {
      if (now_s() - sent < (commands_ == answered ? repeat_after_s : rest_s)) continue;
      if (commands_ != answered) {
        world_.advance_to(world_.time() + frame_period_s);
        answered = commands_;
        note();
      }
      show();
      sent = now_s();
    }
  }

 private:
  void obey(const Velocity& velocity) {
    asked_ = velocity;
    ++commands_;
    world_.command(velocity);
    note();
  }

  /// Records all events of the base, on the clock that all processes share (CLOCK_MONOTONIC).
  void note() {
    const auto truth = world_.truth();
    const Velocity velocity = world_.base().velocity();
    std::fprintf(trace_, "%.6f,%llu,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%d\n", now_s(),
                 static_cast<unsigned long long>(commands_), asked_.linear, asked_.angular, velocity.linear,
                 velocity.angular, truth.robot_x, truth.robot_y, truth.distance, truth.in_box ? 1 : 0);
    std::fflush(trace_);
  }

  void show() {
    const auto pose = world_.base().pose();
    const Velocity velocity = world_.base().velocity();
    topics_.publish_odometry({pose.x, pose.y, pose.heading, velocity.linear, velocity.angular});
    if (!topics_.is_watched()) return;
    world_.render(depth::FrameSpan(disparities_));
    std::transform(disparities_.begin(), disparities_.end(), mm_.begin(), [](std::uint16_t disparity) {
      const bool reading = disparity <= 1022;
      return static_cast<std::uint16_t>(reading ? depth::disparity_to_mm(disparity) : 0);
    });
    topics_.publish_image(mm_);
  }

  World world_;
  std::vector<std::uint16_t> disparities_, mm_;
  Velocity asked_;
  std::uint64_t commands_ = 0;
  std::FILE* trace_ = nullptr;
  iotcloud::tests::RobotTopics topics_;
};

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"A simulated TurtleBot as a ROS node.", "ros_robot"};
  std::string trace;
  std::uint64_t seed = 1;
  bool lock_step = false;
  app.add_option("--trace", trace, "CSV file: what the base was asked and what it did")->required();
  app.add_option("--seed", seed, "of the world");
  app.add_flag("--lockstep", lock_step, "the world moves on when a frame was answered");
  CLI11_PARSE(app, argc, argv);
  try {
    Robot robot(seed, trace);
    if (lock_step) {
      robot.run_lock_step();
    } else {
      robot.run_real_time();
    }
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "ros_robot: %s\n", e.what());
    return 1;
  }
}
