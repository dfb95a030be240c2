#include <iotcloud/drivers/http/http_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::http::HttpDriver, "http", "1.0")
