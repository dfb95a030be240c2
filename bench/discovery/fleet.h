#pragma once

#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>

namespace iotcloud::bench {

/// Options of all programs of `./dev bench discovery`.
struct FleetOptions {
  std::string registry;  ///< "zookeeper://host:port/chroot" or "embedded://NAME"
  std::string broker;    ///< URL of the broker
  int instances = 10'000;
  int fresh = 200;  ///< driver instances that appear while a topology runs
  double rest = 5;  ///< seconds without any change
  bool shared = false;
  std::vector<pid_t> server;
};
/// \throws std::invalid_argument with the program's usage.
FleetOptions parse_fleet_options(int argc, char** argv);

/// A fleet of driver instances on 20 gateways, with two channels each: `data` from the driver and `control` to it.
/// Later instances are on a gateway of their own, so that each adds a topic even if channels are shared.
class Fleet {
 public:
  explicit Fleet(const FleetOptions& options) : options_(options) {}

  /// Paths with their data, parents before children, of the instance with this number.
  std::vector<std::pair<std::string, std::string>> nodes(int instance) const;
  /// The nodes above all instances.
  std::vector<std::string> parents() const;
  std::string instance_path(int instance) const;
  /// The queue from which the topology `topology` reads an instance's data.
  std::string queue(int instance, const std::string& topology) const;
  /// Topics with data of the first `instances` instances.
  int topics() const;

  static constexpr int gateways = 20;
  static constexpr const char* driver = "sensor";

 private:
  discovery::GatewayId gateway(int instance) const;
  static discovery::InstanceId id(int instance);
  std::string wire_name(int instance, const std::string& channel) const;
  discovery::ChannelRecord channel(int instance, const std::string& name, discovery::Direction direction) const;

  const FleetOptions options_;
  const discovery::Paths paths_{"/iot/sensors"};
};

}  // namespace iotcloud::bench
