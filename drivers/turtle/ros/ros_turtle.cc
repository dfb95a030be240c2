#include <stdexcept>
#include <string>
#include <utility>

#include <iotcloud/drivers/turtle/ros/ros_turtle.h>

namespace iotcloud::drivers::turtle::ros {

namespace {

std::string read_topic(PropertyReader& reader, const std::string& property, const std::string& fallback) {
  std::string topic = reader.text(property, fallback);
  if (const std::string problem = drivers::ros::problem_of_topic(topic); !topic.empty() && !problem.empty()) {
    throw std::invalid_argument("property \"" + property + "\" is \"" + topic +
                                "\"; it takes the name of a ROS topic: " + problem);
  }
  return topic;
}

RosOptions read_ros_options(PropertyReader& reader, const TurtleOptions& common, DeviceParts parts) {
  RosOptions options;
  options.period = common.period();
  options.master = drivers::ros::parse_master_address(reader.text("ros_master", drivers::ros::default_master()));
  options.topics = {read_topic(reader, "depth_topic", "/camera/depth/image_raw"),
                    read_topic(reader, "velocity_topic", "/cmd_vel"), read_topic(reader, "odometry_topic", "")};
  if (!parts.source) options.topics.depth.clear();
  if (!parts.actuator) options.topics.velocity.clear();
  return options;
}

}  // namespace

RosTurtle::RosTurtle()
    : TurtleDriver([this] {
        DeviceKind kind;
        kind.name = "ros";
        kind.source = kind.actuator = true;
        kind.read = [this](PropertyReader& reader, const TurtleOptions& common, DeviceParts parts) -> DeviceMaker {
          const RosOptions options = read_ros_options(reader, common, parts);
          has_odometry_ = !options.topics.odometry.empty();
          return [this, options](DriverContext& context) { return make_robot(options, context); };
        };
        return shipped_kinds().with(std::move(kind));
      }()) {}

Device RosTurtle::make_robot(const RosOptions& options, DriverContext& context) {
  const auto robot = std::make_shared<RosRobot>(options, context);
  robot_ = robot;
  return {robot, robot};
}

std::vector<ChannelSpec> RosTurtle::channels(const PropertyMap& properties) {
  has_odometry_ = false;
  auto channels = TurtleDriver::channels(properties);
  if (has_odometry_) {
    ChannelSpec odometry;
    odometry.name = RosRobot::odometry_channel;
    odometry.direction = Direction::out;
    odometry.broker = channels.front().broker;
    odometry.when_full = WhenFull::keep_newest;
    odometry.capacity = 16;
    channels.push_back(std::move(odometry));
  }
  return channels;
}

void RosTurtle::activate() {
  TurtleDriver::activate();
  if (const auto robot = robot_.lock()) robot->set_active(true);
}

void RosTurtle::deactivate() {
  if (const auto robot = robot_.lock()) robot->set_active(false);
  TurtleDriver::deactivate();
}

void RosTurtle::close() {
  TurtleDriver::close();
  if (const auto robot = robot_.lock()) robot->close();
}

}  // namespace iotcloud::drivers::turtle::ros
