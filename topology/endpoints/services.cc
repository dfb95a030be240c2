#include <algorithm>
#include <sstream>

#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/discovery/channel_names.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

namespace {

std::string property(const discovery::ChannelRecord& channel, const char* key) {
  const auto found = channel.properties.find(key);
  return found == channel.properties.end() ? std::string() : found->second;
}

/// The original's gateways write Kafka's servers without a scheme.
std::string url_of(const discovery::ChannelRecord& channel) {
  const bool bare = channel.broker_url.find("://") == std::string::npos;
  return bare && discovery::is_on_kafka(channel) ? "kafka://" + channel.broker_url : channel.broker_url;
}

std::string unique_name() {
  return fmt::format("{}-{}-{}", config::host_name(), getpid(), discovery::new_instance_id().str().substr(0, 8));
}

}  // namespace

EndpointServicesPtr make_endpoint_services(const TopologyDefinition& definition, const config::Clock* clock,
                                           config::Metrics* metrics) {
  auto services = std::make_shared<EndpointServices>();
  services->topology = definition.name;
  services->worker = unique_name();
  services->paths = discovery::Paths(definition.zk_root);
  services->broker_options = definition.brokers;
  services->other_brokers.heartbeat = brokers::usual_heartbeat(definition.registry.session_timeout);
  services->clock = clock != nullptr ? clock : &config::system_clock();
  services->traces = std::make_shared<MessageTraces>(*services->clock);
  services->metrics = metrics != nullptr ? metrics : &config::process_metrics();
  services->brokers = std::make_shared<brokers::BrokerPool>(clock, services->metrics);
  if (services->clock == &config::system_clock())
    services->fence = std::make_shared<StandstillFence>(*services->clock, longest_standstill(*services));
  return services;
}

/// One heartbeat: a broker closes a connection after two of silence at the earliest, and the process may have been
/// silent for one when it stops.
std::chrono::milliseconds longest_standstill(const EndpointServices& services) {
  auto shortest = services.other_brokers.heartbeat;
  for (const auto& [name, options] : services.broker_options) shortest = std::min(shortest, options.heartbeat);
  return shortest;
}

brokers::Topic topic_of(const discovery::ChannelRecord& channel) {
  const std::string exchange = discovery::is_on_kafka(channel) ? "" : property(channel, "exchange");
  return {exchange, discovery::wire_name(channel), property(channel, "durable") == "true"};
}

std::string misfit(const discovery::ChannelRecord& channel, discovery::Direction wanted, const std::string& broker) {
  if (channel.direction != wanted) {
    return wanted == discovery::Direction::out ? "it brings messages to the driver, so there is nothing to read"
                                               : "it brings messages from the driver";
  }
  if (channel.transport != broker) {
    return "it uses the broker \"" + channel.transport + "\", and the topology names \"" + broker + "\"";
  }
  return topic_of(channel).name.empty() ? "its record names no topic" : "";
}

brokers::BrokerAddress address_of(const discovery::ChannelRecord& channel, const EndpointServices& services) {
  brokers::BrokerAddress address{channel.transport, {}};
  const auto options = services.broker_options.find(channel.transport);
  if (options != services.broker_options.end()) address.urls = options->second.urls;
  if (!address.urls.empty()) {
    address.prefer(url_of(channel));
    return address;
  }
  std::istringstream urls(property(channel, "urls"));
  for (std::string url; urls >> url;) address.urls.push_back(url);
  if (address.urls.empty()) address.urls.push_back(url_of(channel));
  return address;
}

std::shared_ptr<PartitionAgreement> agreement_of(const std::string& spout, const EndpointServices& services) {
  const auto found = services.agreements.find(spout);
  return found == services.agreements.end() ? std::make_shared<PartitionAgreement>() : found->second;
}

const std::string& group_of(const EndpointDefinition& endpoint, const EndpointServices& services) {
  return endpoint.group.empty() ? services.topology.str() : endpoint.group;
}

DriverUnits::Source source_of(const EndpointDefinition& endpoint, const EndpointServices& services) {
  return {group_of(endpoint, services), endpoint.driver};
}

std::string readers_path(const EndpointDefinition& endpoint, const EndpointServices& services) {
  return services.paths.readers(group_of(endpoint, services), endpoint.driver, endpoint.channel);
}

std::uint8_t priority_of(const discovery::ChannelRecord& channel) {
  const std::string text = property(channel, "priority");
  const bool digit = text.size() == 1 && text[0] >= '0' && text[0] <= '9';
  return digit ? static_cast<std::uint8_t>(text[0] - '0') : brokers::normal_priority;
}

std::shared_ptr<brokers::Broker> broker_at(const brokers::BrokerAddress& address, const EndpointServices& services) {
  const auto options = services.broker_options.find(address.broker);
  return services.brokers->get(address,
                               options == services.broker_options.end() ? services.other_brokers : options->second);
}

}  // namespace iotcloud::topology
