#include <iotcloud/drivers/can/can_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::can::CanDriver, "can", "1.0")
