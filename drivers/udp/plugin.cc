#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/udp/udp_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::udp::UdpDriver, "udp", "1.0")
