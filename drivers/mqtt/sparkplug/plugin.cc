#include <iotcloud/drivers/mqtt/sparkplug/sparkplug_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::mqtt::sparkplug::SparkplugDriver, "sparkplug", "1.0", true)
