#include <set>

#include <iotcloud/topology/worker/meeting_spouts.h>

namespace iotcloud::topology {

namespace {

/// The drivers of the spouts that the file defines, by component.
std::map<std::string, discovery::DriverName> drivers_of(const TopologyDefinition& definition) {
  std::map<std::string, discovery::DriverName> drivers;
  for (const auto& spout : definition.spouts) {
    if (spout.endpoint) drivers.emplace(spout.id, spout.endpoint->driver);
  }
  return drivers;
}

std::set<std::string> senders_of(const TopologyDefinition& definition) {
  std::set<std::string> senders;
  for (const auto& bolt : definition.bolts) {
    if (bolt.endpoint) senders.insert(bolt.id);
  }
  return senders;
}

}  // namespace

std::map<std::string, std::shared_ptr<PartitionAgreement>> agreements_by_spout(const TopologyDefinition& definition,
                                                                               const Topology& topology) {
  const auto drivers = drivers_of(definition);
  const auto senders = senders_of(definition);
  std::map<std::string, std::shared_ptr<PartitionAgreement>> agreements;
  for (const auto& [spout, driver] : drivers) agreements[spout] = std::make_shared<PartitionAgreement>();
  std::map<std::string, std::set<std::string>> spouts_of;       // by component: the spouts whose tuples reach it
  for (const ComponentSpec& component : topology.components) {  // sources come before the bolts that they feed
    auto& spouts = spouts_of[component.id];
    if (drivers.contains(component.id)) spouts.insert(component.id);
    for (const InputSpec& input : component.inputs)
      spouts.insert(spouts_of[input.from].begin(), spouts_of[input.from].end());
    if (senders.contains(component.id)) continue;
    std::map<discovery::DriverName, std::shared_ptr<PartitionAgreement>> of_driver;
    for (const std::string& spout : spouts) {
      const auto together = of_driver.try_emplace(drivers.at(spout), agreements.at(spout)).first->second;
      const auto own = agreements.at(spout);
      for (auto& [other, agreement] : agreements) {
        if (agreement == own) agreement = together;
      }
    }
  }
  return agreements;
}

}  // namespace iotcloud::topology
