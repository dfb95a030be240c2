#include <algorithm>
#include <stdexcept>
#include <utility>

#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/kinect/kinect_source.h>
#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/recording/recorded_source.h>
#include <iotcloud/drivers/turtle/robot/robot_link.h>
#include <iotcloud/drivers/turtle/simulator/simulated_robot.h>

namespace iotcloud::drivers::turtle {

namespace {

/// An actuator that does nothing, for users who want frames only.
class NoActuator final : public Actuator {
 public:
  void drive(const Velocity&) override {}
  void halt() override {}
};

DeviceKind no_actuator() {
  DeviceKind kind;
  kind.name = "none";
  kind.actuator = true;
  kind.read = [](PropertyReader&, const TurtleOptions&, DeviceParts) -> DeviceMaker {
    return [](DriverContext&) { return Device{nullptr, std::make_shared<NoActuator>()}; };
  };
  return kind;
}

}  // namespace

DeviceKinds DeviceKinds::with(DeviceKind kind) && {
  std::erase_if(kinds_, [&](const DeviceKind& other) { return other.name == kind.name; });
  kinds_.push_back(std::move(kind));
  return std::move(*this);
}

std::vector<std::string> DeviceKinds::names(bool DeviceKind::*role) const {
  std::vector<std::string> names;
  for (const DeviceKind& kind : kinds_) {
    if (kind.*role) names.push_back(kind.name);
  }
  return names;
}

const DeviceKind& DeviceKinds::find(const std::string& name) const {
  return *std::find_if(kinds_.begin(), kinds_.end(), [&](const DeviceKind& kind) { return kind.name == name; });
}

DeviceMaker DeviceKinds::read(PropertyReader& reader, const TurtleOptions& options) const {
  const DeviceKind& source = find(reader.choice("source", "simulator", names(&DeviceKind::source)));
  const DeviceKind& actuator =
      find(reader.choice("actuator", source.actuator ? source.name : "none", names(&DeviceKind::actuator)));
  if (&source == &actuator) return source.read(reader, options, {true, true});
  if (actuator.pair_only) {
    throw std::invalid_argument("property \"actuator\" is \"" + actuator.name + "\", which goes with the source \"" +
                                actuator.name + "\" only, and the source is \"" + source.name + "\"");
  }
  return [make_source = source.read(reader, options, {true, false}),
          make_actuator = actuator.read(reader, options, {false, true})](DriverContext& context) {
    return Device{make_source(context).source, make_actuator(context).actuator};
  };
}

DeviceKinds shipped_kinds() {
  return DeviceKinds()
      .with(simulator::simulator_kind())
      .with(kinect::kinect_kind())
      .with(recording::recording_kind())
      .with(robot::robot_kind())
      .with(no_actuator());
}

}  // namespace iotcloud::drivers::turtle
