#include <iotcloud/drivers/exec/exec_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::exec::ExecDriver, "exec", "1.0", true)
