#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/usb/usb_finder.h>

IOTCLOUD_DRIVER(iotcloud::drivers::usb::UsbFinder, "usb_finder", "1.0")
