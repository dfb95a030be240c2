#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/ros/ros_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::ros::RosDriver, "ros", "1.0", true)
IOTCLOUD_DRIVER_ISOLATED  // roscpp allows one node in a process
