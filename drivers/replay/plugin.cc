#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/replay/replay_driver.h>

IOTCLOUD_DRIVER(iotcloud::drivers::replay::ReplayDriver, "replay", "1.0")
