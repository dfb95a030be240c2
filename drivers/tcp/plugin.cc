#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/tcp/tcp_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::tcp::TcpDriver, "tcp", "1.0")
