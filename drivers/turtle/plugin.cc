#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::turtle::TurtleDriver, "turtle", "1.0", true)
