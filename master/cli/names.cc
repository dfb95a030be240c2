#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/names.h>

namespace iotcloud::master::cli {

std::vector<std::string> names_of(NameKind kind, const Command& command) {
  MasterClient master(command.masters, {command.tls, command.token}, command.election_patience);
  std::vector<std::string> names;
  switch (kind) {
    case NameKind::gateways:
      for (const auto& gateway : master.gateways()) names.push_back(gateway.siteId);
      break;
    case NameKind::topologies:
      for (const auto& topology : master.topologies()) names.push_back(topology.name);
      break;
    case NameKind::instances:
      for (const auto& driver : master.drivers()) names.push_back(driver.sensorId);
      break;
    case NameKind::drivers:
      for (const auto& driver : master.drivers()) names.push_back(driver.name);
      break;
    case NameKind::deployments:
      for (const auto& driver : master.drivers()) names.push_back(driver.deployment);
      break;
  }
  return names;
}

}  // namespace iotcloud::master::cli
