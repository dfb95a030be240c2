#include <iotcloud/drivers/plugin.h>
#include <iotcloud/tests/gateway/probe_driver.h>

IOTCLOUD_DRIVER(iotcloud::gateway::ProbeDriver, "probe", "1.0")
