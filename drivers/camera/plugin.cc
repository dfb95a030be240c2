#include <iotcloud/drivers/camera/camera_driver.h>
#include <iotcloud/drivers/plugin.h>

IOTCLOUD_DRIVER(iotcloud::drivers::camera::CameraDriver, "camera", "1.0", true)
