#include <iotcloud/drivers/lan/onvif_finder.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::lan::OnvifFinder, "onvif_finder", "1.0")
