#include <iotcloud/drivers/modbus/modbus_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::modbus::ModbusDriver, "modbus", "1.0", true)
