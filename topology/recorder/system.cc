#include <fmt/format.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/topology/definition/connections.h>
#include <iotcloud/topology/recorder/system.h>

namespace iotcloud::recorder {

System::System(const SystemOptions& options) {
  discovery::RegistryOptions registry;
  if (!options.config.empty()) {
    config::YamlSection::read_file(options.config, [&](config::YamlSection& root) {
      registry = topology::read_registry(root);
      services_.paths = discovery::Paths(topology::read_zk_root(root));
      services_.broker_options = topology::read_brokers(root, registry.session_timeout);
      if (!root.has("spouts")) root.finish();  // of a topology's file the rest is its worker's
    });
  }
  users_ = registry.access != nullptr;
  if (!options.registry.empty()) registry.url = options.registry;
  if (registry.url.empty()) registry.url = "zookeeper://127.0.0.1:2181";
  for (const auto& [name, url] : options.brokers) {
    auto& broker = services_.broker_options[name];
    if (brokers::are_credentials_given(broker))
      throw config::Error(
          fmt::format("--broker {}: {} has credentials for this broker, which go to the addresses of "
                      "that file only; change them there",
                      name, options.config));
    broker.urls = {url};
    broker.heartbeat = brokers::usual_heartbeat(registry.session_timeout);
    static_cast<void>(brokers::broker_kind(url));
  }
  services_.other_brokers.heartbeat = brokers::usual_heartbeat(registry.session_timeout);
  services_.clock = &config::system_clock();
  services_.metrics = &config::process_metrics();
  services_.brokers = std::make_shared<brokers::BrokerPool>(nullptr, services_.metrics);
  registry_ = discovery::make_registry(registry);
}

std::shared_ptr<brokers::Broker> System::broker_of(const discovery::ChannelRecord& channel) const {
  const auto own = services_.broker_options.find(channel.transport);
  if (users_ && (own == services_.broker_options.end() || own->second.urls.empty()))
    throw config::Error(
        fmt::format("the broker \"{}\" has no address in the configuration, and with \"registry.users\" "
                    "whoever has one gateway's user could name any: add \"brokers: {{{}: {{urls: "
                    "[...]}}}}\" to it",
                    channel.transport, channel.transport));
  return topology::broker_at(topology::address_of(channel, services_), services_);
}

brokers::Topic System::topic_of(const discovery::ChannelRecord& channel) {
  auto topic = topology::topic_of(channel);
  if (topic.name.empty())
    throw config::Error(fmt::format("the record of channel {} of {} names no topic", channel.name, channel.instance));
  return topic;
}

}  // namespace iotcloud::recorder
