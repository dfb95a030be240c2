#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <utility>

#include <geometry_msgs/Twist.h>
#include <nav_msgs/Odometry.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <iotcloud/tests/drivers/turtle/ros/robot_topics.h>

namespace iotcloud::tests {

namespace {

sensor_msgs::Image image_of(const char* encoding, std::uint32_t pixel_bytes) {
  sensor_msgs::Image image;
  image.header.stamp = ::ros::Time::now();
  image.header.frame_id = "camera_depth_optical_frame";
  image.width = 640;
  image.height = 480;
  image.encoding = encoding;
  image.step = image.width * pixel_bytes;
  image.data.resize(std::size_t{image.step} * image.height);
  return image;
}

::ros::M_string node_settings() {
  return {{"__log", "/dev/null"}};
}

}  // namespace

struct RobotTopics::Impl {
  explicit Impl(std::function<void(double, double)> on_velocity) {
    raw = node.advertise<sensor_msgs::Image>("/camera/depth/image_raw", 1);
    metres = node.advertise<sensor_msgs::Image>("/camera/depth/image", 1);
    colour = node.advertise<sensor_msgs::Image>("/camera/rgb/image_raw", 1);
    odometry = node.advertise<nav_msgs::Odometry>("/odom", 10);
    velocity = node.subscribe<geometry_msgs::Twist>(
        "/cmd_vel_mux/input/navi", 10,
        [obey = std::move(on_velocity)](const geometry_msgs::TwistConstPtr& twist) {
          obey(twist->linear.x, twist->angular.z);
        },
        {}, ::ros::TransportHints().tcpNoDelay());
  }
  ::ros::NodeHandle node;
  ::ros::Publisher raw, metres, colour, odometry;
  ::ros::Subscriber velocity;
};

RobotTopics::RobotTopics(std::function<void(double, double)> on_velocity) {
  ::ros::init(node_settings(), "simulated_turtlebot",
              ::ros::init_options::AnonymousName | ::ros::init_options::NoRosout);
  impl_ = std::make_unique<Impl>(std::move(on_velocity));
}

RobotTopics::~RobotTopics() = default;

bool RobotTopics::spin(double wait_s) {
  ::ros::getGlobalCallbackQueue()->callAvailable(::ros::WallDuration(wait_s));
  return ::ros::ok();
}

bool RobotTopics::is_watched() const {
  return impl_->raw.getNumSubscribers() + impl_->metres.getNumSubscribers() + impl_->colour.getNumSubscribers() > 0;
}

void RobotTopics::publish_image(const std::vector<std::uint16_t>& mm) {
  if (impl_->raw.getNumSubscribers() > 0) {
    auto image = image_of("16UC1", sizeof(std::uint16_t));
    std::memcpy(image.data.data(), mm.data(), image.data.size());
    impl_->raw.publish(image);
  }
  if (impl_->metres.getNumSubscribers() > 0) {
    auto image = image_of("32FC1", sizeof(float));
    for (std::size_t i = 0; i < mm.size(); ++i) {
      const float depth = mm[i] == 0 ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(mm[i]) / 1000;
      std::memcpy(image.data.data() + i * sizeof(float), &depth, sizeof depth);
    }
    impl_->metres.publish(image);
  }
  if (impl_->colour.getNumSubscribers() > 0) impl_->colour.publish(image_of("rgb8", 3));
}

void RobotTopics::publish_odometry(const RobotPose& pose) {
  nav_msgs::Odometry odometry;
  odometry.header.stamp = ::ros::Time::now();
  odometry.header.frame_id = "odom";
  odometry.pose.pose.position.x = pose.x;
  odometry.pose.pose.position.y = pose.y;
  odometry.pose.pose.orientation.z = std::sin(pose.heading / 2);
  odometry.pose.pose.orientation.w = std::cos(pose.heading / 2);
  odometry.twist.twist.linear.x = pose.linear;
  odometry.twist.twist.angular.z = pose.angular;
  impl_->odometry.publish(odometry);
}

}  // namespace iotcloud::tests
