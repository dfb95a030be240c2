#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/placement/driver_units.h>
#include <iotcloud/topology/endpoints/placement/partition_agreement.h>
#include <iotcloud/topology/endpoints/receiving/arrivals.h>
#include <iotcloud/topology/endpoints/receiving/held_messages.h>
#include <iotcloud/topology/endpoints/receiving/message_traces.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>
#include <iotcloud/topology/runtime/trouble_board.h>

namespace iotcloud::topology {

/// The objects that the endpoints of a worker share. The worker fills it before the topology starts; it is constant
/// from then on.
struct EndpointServices {
  discovery::TopologyName topology;                ///< also the name of a spout's group if YAML sets none
  std::string worker;                              ///< this worker's name below Paths::workers(topology)
  std::string engine = discovery::engine_workers;  ///< discovery::ReaderRecord::engine
  discovery::Registry* registry = nullptr;         ///< must outlive the topology
  discovery::Paths paths;
  /// By logical broker name: how to connect. URLs that are set here replace those in the channels' records; credentials
  /// come with URLs always (definition.cc).
  std::map<std::string, brokers::BrokerOptions> broker_options;
  brokers::BrokerOptions other_brokers;  ///< for brokers that broker_options does not name
  std::shared_ptr<brokers::BrokerPool> brokers;
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  /// By spout: the bolts below it that keep tuples by design, and for how long, for messages. Without an entry: none.
  std::map<std::string, std::string> keepers;
  std::map<std::string, std::shared_ptr<const Arrivals>> arrivals;        ///< by spout; the spouts' factories fill it
  std::shared_ptr<HeldMessages> held = std::make_shared<HeldMessages>();  ///< never null
  std::shared_ptr<TroubleBoard> troubles = std::make_shared<TroubleBoard>();     ///< never null; the runtime's, too
  std::shared_ptr<StandstillFence> fence = std::make_shared<StandstillFence>();  ///< never null
  std::shared_ptr<DriverUnits> units = std::make_shared<DriverUnits>();          ///< never null
  std::shared_ptr<MessageTraces> traces =
      std::make_shared<MessageTraces>(config::system_clock());  ///< never null; by `clock`
  /// By spout: what its channels must agree with (worker/meeting_spouts.h). Without an entry: with nothing, as where an
  /// engine takes tuples to other workers.
  std::map<std::string, std::shared_ptr<PartitionAgreement>> agreements;
  std::optional<std::chrono::milliseconds> longest_drain;  ///< of what a reader that moves has in hand; nullopt: 2 s
  std::vector<std::function<void()>> before_stop;          ///< the worker calls these before it stops the topology
  std::vector<std::function<void()>> after_stop;           ///< the worker calls these when it has left the registry
};
using EndpointServicesPtr = std::shared_ptr<EndpointServices>;

/// The services of a topology in this process, under a name that no other worker has; its owner adds a registry. With
/// the system's clock the fence notes when the process stands still, so a FenceHeart must beat for it.
/// \param clock nullptr: the system's. \param metrics nullptr: the process's
EndpointServicesPtr make_endpoint_services(const TopologyDefinition& definition, const config::Clock* clock,
                                           config::Metrics* metrics);
/// How long the process may stand still without losing a connection to a broker.
std::chrono::milliseconds longest_standstill(const EndpointServices& services);

/// What the channels that a spout reads must agree with; never null.
std::shared_ptr<PartitionAgreement> agreement_of(const std::string& spout, const EndpointServices& services);
/// The topic of a channel, as its record says.
brokers::Topic topic_of(const discovery::ChannelRecord& channel);
/// Why an endpoint that uses the logical broker `broker` cannot use this channel, as a text for the log; empty: it can.
/// \param wanted out: the endpoint reads the channel; in: it sends to it.
std::string misfit(const discovery::ChannelRecord& channel, discovery::Direction wanted, const std::string& broker);
/// The servers of a channel's broker: those that the topology's file names, the one first that the channel's record
/// prefers; or else those of the channel's record.
brokers::BrokerAddress address_of(const discovery::ChannelRecord& channel, const EndpointServices& services);
/// The name of the group whose workers share the channel's messages; the broker gets it as the consumers' group.
const std::string& group_of(const EndpointDefinition& endpoint, const EndpointServices& services);
/// The endpoint's driver, as that group sees it.
DriverUnits::Source source_of(const EndpointDefinition& endpoint, const EndpointServices& services);
/// The registry's node of that group's readers for the endpoint's channel.
std::string readers_path(const EndpointDefinition& endpoint, const EndpointServices& services);
/// The channel's priority, 0 to 9, from its record; normal_priority if there is none.
std::uint8_t priority_of(const discovery::ChannelRecord& channel);
/// The client of the broker at an address. \throws config::Error when it cannot be used.
std::shared_ptr<brokers::Broker> broker_at(const brokers::BrokerAddress& address, const EndpointServices& services);

}  // namespace iotcloud::topology
