#include <iotcloud/bench/paper/application/load_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::bench::paper::LoadDriver, "paper_load", "1.0")
