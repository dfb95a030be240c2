#include <iotcloud/drivers/lan/mdns_finder.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::lan::MdnsFinder, "mdns_finder", "1.0")
