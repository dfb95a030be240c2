#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/serial/serial_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::serial::SerialDriver, "serial", "1.0")
