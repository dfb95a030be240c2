#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/turtle/ros/ros_turtle.h>

// The same name as turtle.so's: topologies that read "turtle" read both.
IOTCLOUD_DRIVER(iotcloud::drivers::turtle::ros::RosTurtle, "turtle", "1.0", true)
IOTCLOUD_DRIVER_ISOLATED  // roscpp: one node to a process
