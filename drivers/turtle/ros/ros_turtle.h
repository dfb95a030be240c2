#pragma once

#include <memory>
#include <vector>

#include <iotcloud/drivers/turtle/ros/ros_robot.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>

namespace iotcloud::drivers::turtle::ros {

/// The turtle driver with one kind more: `ros`, as source, as actuator or as both. The property `odometry_topic` adds
/// the channel `odometry`.
class RosTurtle final : public TurtleDriver {
 public:
  static constexpr auto declared_properties = with_kind(
      "ros", std::array{PropertySpec{.name = "ros_master", .text = "ros: the master; $ROS_MASTER_URI"},
                        PropertySpec{.name = "depth_topic", .text = "ros: of the camera; /camera/depth/image_raw"},
                        PropertySpec{.name = "velocity_topic", .text = "ros: of the base; /cmd_vel"},
                        PropertySpec{.name = "odometry_topic", .text = "ros: adds the channel odometry; none"}});

  RosTurtle();
  RosTurtle(const RosTurtle&) = delete;
  RosTurtle& operator=(const RosTurtle&) = delete;

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void activate() override;
  void deactivate() override;
  void close() override;

 private:
  Device make_robot(const RosOptions& options, DriverContext& context);

  std::weak_ptr<RosRobot> robot_;  ///< empty if neither source nor actuator is `ros`
  bool has_odometry_ = false;      ///< whether the last properties named an odometry topic
};

}  // namespace iotcloud::drivers::turtle::ros
