#pragma once

#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>

namespace iotcloud::bench {

/// What all programs of `./dev bench discovery` take.
struct FleetOptions {
  std::string registry;  ///< "zookeeper://host:port/chroot" or "embedded://NAME"
  std::string broker;    ///< URL; its scheme says which
  int instances = 10'000;
  int fresh = 200;  ///< driver instances that come while a topology runs
  double rest = 5;  ///< seconds for which everything rests
  bool shared = false;
  std::vector<pid_t> server;
};
/// \throws std::invalid_argument with how to call the program.
FleetOptions parse_fleet_options(int argc, char** argv);

/// A fleet of driver instances with two channels each, `data` from the driver and `control` to it, on 20 gateways;
/// those that come later are on a gateway of their own, so that each brings a topic whatever the channels are.
class Fleet {
 public:
  explicit Fleet(const FleetOptions& options) : options_(options) {}

  /// Paths with their data, parents before children, of the instance with this number.
  std::vector<std::pair<std::string, std::string>> nodes(int instance) const;
  /// The nodes above all instances.
  std::vector<std::string> parents() const;
  std::string instance_path(int instance) const;
  /// The queue of the topology `topology` for an instance's data.
  std::string queue(int instance, const std::string& topology) const;
  /// Topics with data of the first `instances` ones.
  int topics() const;

  static constexpr int gateways = 20;
  static constexpr const char* driver = "sensor";

 private:
  std::string gateway(int instance) const;
  std::string wire_name(int instance, const std::string& channel) const;
  discovery::ChannelRecord channel(int instance, const std::string& name, discovery::Direction direction) const;

  const FleetOptions options_;
  const discovery::Paths paths_{"/iot/sensors"};
};

}  // namespace iotcloud::bench
