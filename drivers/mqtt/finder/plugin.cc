#include <iotcloud/drivers/mqtt/finder/mqtt_finder.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::mqtt::MqttFinder, "mqtt_finder", "1.0", true)
