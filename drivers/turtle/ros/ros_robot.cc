#include <algorithm>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include <iotcloud/drivers/turtle/ros/depth_image.h>
#include <iotcloud/drivers/turtle/ros/ros_robot.h>

namespace iotcloud::drivers::turtle::ros {

using std::chrono::steady_clock;

namespace {

constexpr std::chrono::milliseconds jitter_allowed{8};  // so that a rate of 30 Hz keeps every image of a 30 Hz camera

ImageView view_of(const NodeImage& image) {
  return {image.width, image.height, image.step, image.encoding, image.big_endian, {image.data, image.size}};
}

nlohmann::json as_json(const std::array<double, 3>& vector) {
  return {{"x", vector[0]}, {"y", vector[1]}, {"z", vector[2]}};
}

}  // namespace

RosRobot::RosRobot(const RosOptions& options, DriverContext& context)
    : context_(context), depth_topic_(options.topics.depth), period_(options.period) {
  NodeEvents events;
  events.on_image = [this](const NodeImage& image) { take_image(image); };
  events.on_odometry = [this](const NodeOdometry& odometry) { send_odometry(odometry); };
  events.on_state = [this](const std::string& state) { tell(state); };
  events.on_failed = [this](const std::string& reason) { context_.fail(reason); };
  node_ = std::make_unique<RosNode>(options.master, options.topics, std::move(events));
}

void RosRobot::start(std::function<void(const DepthFrame&)> on_frame) {
  {
    const std::lock_guard lock(mutex_);
    waiting_ = false;  // images from before the last stop() are stale
  }
  on_frame_ = std::move(on_frame);
  wants_frames_ = true;
}

void RosRobot::stop() {
  wants_frames_ = false;
  on_frame_ = nullptr;
}

void RosRobot::drive(const Velocity& velocity) {
  if (node_) node_->publish(velocity.linear, velocity.angular);
}

void RosRobot::halt() {
  drive({});
}

void RosRobot::close() {
  if (!std::exchange(node_, nullptr)) return;
  context_.log(LogLevel::info, "ROS: " + std::to_string(images_) + " images, of these " + std::to_string(refused_) +
                                   " refused and " + std::to_string(superseded_) + " replaced by a newer one");
}

void RosRobot::take_image(const NodeImage& image) {
  const Instant now = steady_clock::now();
  if (!wants_frames_ || now + jitter_allowed < due_) return;
  due_ = std::max(due_ + period_, now);
  read_.captured = now;
  read_.device_time_s = image.stamp_s;
  ++images_;
  const std::string problem = convert_depth_image(view_of(image), depth::FrameSpan(read_.disparities));
  if (!problem.empty()) {
    refuse(problem);
    return;
  }
  if (std::exchange(refusing_, false)) context_.update_metadata({{"ros_images", ""}});
  {
    const std::lock_guard lock(mutex_);
    std::swap(read_, newest_);
    if (std::exchange(waiting_, true)) {
      ++superseded_;
      return;
    }
  }
  context_.post([this] { hand_over(); });
}

/// Logs each problem once: a camera repeats it thirty times a second.
void RosRobot::refuse(const std::string& problem) {
  ++refused_;
  if (!std::exchange(refusing_, true)) context_.update_metadata({{"ros_images", "refused: " + problem}});
  if (std::exchange(last_problem_, problem) == problem) return;
  context_.log(LogLevel::warn, "an image on " + depth_topic_ + " is refused, as are others like it: " + problem);
}

void RosRobot::hand_over() {
  {
    const std::lock_guard lock(mutex_);
    if (!std::exchange(waiting_, false)) return;
    std::swap(newest_, shown_);
  }
  if (!on_frame_) return;
  DepthFrame frame;
  frame.disparities = depth::FrameView(shown_.disparities);
  frame.captured = shown_.captured;
  frame.device_time_s = shown_.device_time_s;
  const auto on_frame = on_frame_;  // a copy: the callback may stop the source
  on_frame(frame);
}

void RosRobot::send_odometry(const NodeOdometry& odometry) {
  if (!active_) return;
  context_.publish(odometry_channel, Payload::copy(odometry_json(odometry)));
}

void RosRobot::tell(const std::string& state) {
  context_.log(LogLevel::info, "ROS: " + state);
  context_.update_metadata({{"ros", state}});
}

std::string odometry_json(const NodeOdometry& odometry) {
  const auto& [x, y, z, w] = odometry.orientation;
  const double heading = std::atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  const nlohmann::json json{
      {"stamp_ms", std::llround(odometry.stamp_s * 1000)},
      {"frame", odometry.frame},
      {"position", as_json(odometry.position)},
      {"orientation", {{"x", x}, {"y", y}, {"z", z}, {"w", w}}},
      {"heading", heading},
      {"linear", as_json(odometry.linear)},
      {"angular", as_json(odometry.angular)},
  };
  // A frame's name may have any bytes.
  return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace iotcloud::drivers::turtle::ros
