#include <iotcloud/drivers/loadgen/load_generator.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::loadgen::LoadGenerator, "loadgen", "1.0")
