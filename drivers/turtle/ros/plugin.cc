#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/turtle/ros/ros_turtle.h>

// Has the name of turtle.so's driver, so that topologies that read "turtle" read both.
IOTCLOUD_DRIVER(iotcloud::drivers::turtle::ros::RosTurtle, "turtle", "1.0", true)
IOTCLOUD_DRIVER_ISOLATED  // roscpp allows one node in a process
