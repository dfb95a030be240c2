#include <iotcloud/drivers/mqtt/mqtt_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::mqtt::MqttDriver, "mqtt", "1.0", true)
