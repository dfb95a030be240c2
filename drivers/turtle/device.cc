#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/simulator/simulated_robot.h>

namespace iotcloud::drivers::turtle {

Device make_device(const TurtleOptions& options, DriverContext& context) {
  // read_options() lets no other name than "simulator" through, for the source and for the actuator.
  auto robot = std::make_shared<simulator::SimulatedRobot>(options, context);
  return {robot, robot};
}

}  // namespace iotcloud::drivers::turtle
