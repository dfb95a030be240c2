#include <array>
#include <cstdint>
#include <random>
#include <string_view>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::discovery {
namespace {

/// Appends a name that came from outside. Refuses a name that would lead to another place of the tree.
std::string below(const std::string& parent, const std::string& name) {
  if (name.empty() || name == "." || name == ".." || name.find('/') != std::string::npos ||
      name.find('\0') != std::string::npos) {
    throw config::Error("\"" + name + "\" cannot be a name in the registry (below " + parent +
                        "): it must not be empty, \".\" or \"..\", nor contain \"/\"");
  }
  return parent + "/" + name;
}

}  // namespace

Paths::Paths(std::string sensors_root) : sensors(std::move(sensors_root)) {
  const auto slash = sensors.rfind('/');
  if (sensors.size() < 2 || sensors.front() != '/' || sensors.back() == '/' ||
      sensors.find("//") != std::string::npos) {
    throw config::Error("zk.root: \"" + sensors + "\" is no path of the form /iot/sensors");
  }
  const std::string parent = sensors.substr(0, slash);
  gateways = parent + "/gateways";
  topologies = parent + "/topologies";
  groups = parent + "/groups";
  pools = parent + "/pools";
  submissions = parent + "/submissions";
  const auto others = branches();
  for (auto taken = others.begin() + 1; taken != others.end(); ++taken) {
    if (sensors == *taken) throw config::Error("zk.root: \"" + sensors + "\" is taken by records of another kind");
  }
}

std::vector<std::string> Paths::branches() const {
  return {sensors, gateways, topologies, groups, pools, submissions, masters()};
}

std::string Paths::driver(const DriverName& driver) const {
  return below(sensors, driver);
}
std::string Paths::instance(const DriverName& driver, const InstanceId& instance) const {
  return below(this->driver(driver), instance);
}
std::string Paths::channel(const DriverName& driver, const InstanceId& instance, const std::string& channel) const {
  return below(this->instance(driver, instance), channel);
}
std::string Paths::gateway(const GatewayId& id) const {
  return below(gateways, id);
}
std::string Paths::gateway_alive(const GatewayId& id) const {
  return gateway(id) + "/alive";
}
std::string Paths::gateway_draining(const GatewayId& id) const {
  return gateway(id) + "/draining";
}
std::string Paths::orders(const GatewayId& id) const {
  return gateway(id) + "/orders";
}
std::string Paths::order(const GatewayId& id, const InstanceId& instance) const {
  return below(orders(id), instance);
}
std::string Paths::removals(const GatewayId& id) const {
  return gateway(id) + "/removals";
}
std::string Paths::removal(const GatewayId& id, const InstanceId& instance) const {
  return below(removals(id), instance);
}
std::string Paths::masters() const {
  return sensors.substr(0, sensors.rfind('/')) + "/masters";
}
std::string Paths::topology(const TopologyName& name) const {
  return below(topologies, name);
}
std::string Paths::workers(const TopologyName& topology) const {
  return this->topology(topology) + "/workers";
}
std::string Paths::topology_order(const TopologyName& topology) const {
  return this->topology(topology) + "/wanted";
}
std::string Paths::ended_workers(const TopologyName& topology) const {
  return this->topology(topology) + "/ended";
}
std::string Paths::submission(const TopologyName& topology) const {
  return below(submissions, topology) + "/wanted";
}
std::string Paths::topology_history(const TopologyName& topology) const {
  return below(submissions, topology) + "/history";
}
std::string Paths::places(const TopologyName& topology) const {
  return this->topology(topology) + "/places";
}
std::string Paths::place(const TopologyName& topology, int number) const {
  return places(topology) + "/" + std::to_string(number);
}
std::string Paths::pool(const PoolId& id) const {
  return below(pools, id);
}
std::string Paths::readers(const std::string& group, const DriverName& driver, const std::string& channel) const {
  return below(below(below(groups, group), driver), channel);
}

InstanceId new_instance_id() {
  constexpr std::string_view digits = "0123456789abcdef";
  std::random_device random;
  std::array<std::uint8_t, 16> bytes{};
  for (std::size_t i = 0; i < bytes.size(); i += 4) {
    const std::uint32_t word = random();
    for (std::size_t k = 0; k < 4; ++k) bytes[i + k] = static_cast<std::uint8_t>(word >> (8 * k));
  }
  bytes[6] = static_cast<std::uint8_t>((bytes[6] & 0x0F) | 0x40);  // RFC 4122: version 4,
  bytes[8] = static_cast<std::uint8_t>((bytes[8] & 0x3F) | 0x80);  // variant 1
  std::string id;
  for (const std::uint8_t byte : bytes) {
    id += digits[byte >> 4];
    id += digits[byte & 15];
  }
  return InstanceId(std::move(id));
}

}  // namespace iotcloud::discovery
