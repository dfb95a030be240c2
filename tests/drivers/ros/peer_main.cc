// A ROS node for tests: publishes each 20 ms, and says what it hears. In C++17, like all that includes ROS's messages.
#include <cmath>
#include <limits>
#include <string>

#include <geometry_msgs/Twist.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Empty.h>
#include <std_msgs/String.h>

int main(int argc, char** argv) {
  ros::init(argc, argv, "ros_peer", ros::init_options::NoRosout);
  ros::NodeHandle node;
  constexpr std::uint32_t queue = 1000;
  const auto odometry = node.advertise<nav_msgs::Odometry>("/odom", queue);
  const auto image = node.advertise<sensor_msgs::Image>("/image", queue);
  const auto joints = node.advertise<sensor_msgs::JointState>("/joints", queue);
  const auto heard = node.advertise<std_msgs::String>("/heard", queue, true);
  const auto latched = node.advertise<std_msgs::String>("/latched", queue, true);
  std_msgs::String once;
  once.data = "caf\xc3\xa9 \xff \"quoted\"";  // one byte is no UTF-8
  latched.publish(once);
  const auto say = [&heard](const std::string& text) {
    std_msgs::String said;
    said.data = text;
    heard.publish(said);
  };
  const auto velocity =
      node.subscribe<geometry_msgs::Twist>("/cmd_vel", queue, [&say](const geometry_msgs::Twist::ConstPtr& twist) {
        say("velocity " + std::to_string(twist->linear.x) + " " + std::to_string(twist->angular.z));
      });
  const auto text = node.subscribe<std_msgs::String>(
      "/say", queue, [&say](const std_msgs::String::ConstPtr& said) { say("text " + said->data); });
  const auto last = node.advertise<std_msgs::Empty>("/last", 1);  // whoever waits for it knows of the others
  ros::WallRate rate(50);
  for (int count = 0; ros::ok(); ++count) {
    nav_msgs::Odometry where;
    where.header.stamp = ros::Time(1'700'000'000, 5);
    where.header.frame_id = "odom";
    where.pose.pose.position.x = count;
    where.pose.covariance[35] = 0.25;
    odometry.publish(where);
    sensor_msgs::Image picture;
    picture.width = 2;
    picture.height = 1;
    picture.encoding = "rgb8";
    picture.step = 6;
    picture.data = {0, 1, 2, 253, 254, 255};
    image.publish(picture);
    sensor_msgs::JointState state;
    state.name = {"knee", "hip"};
    state.position = {0.5, std::numeric_limits<double>::quiet_NaN()};
    joints.publish(state);
    ros::spinOnce();
    rate.sleep();
  }
}
