#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/endpoints/message_fields.h>
#include <iotcloud/topology/endpoints/receiving/broker_spout.h>
#include <iotcloud/topology/endpoints/sending/broker_bolt.h>

namespace iotcloud::topology {

EndpointFactories endpoint_factories(EndpointServicesPtr services) {
  EndpointFactories factories;
  factories.spout = [services](const ComponentDefinition& spout) -> SpoutFactory {
    services->units->declare(source_of(*spout.endpoint, *services),
                             spout.endpoint->channel + " x " + std::to_string(spout.tasks) + " " +
                                 (spout.endpoint->where.everything() ? "" : spout.endpoint->where.text()));
    auto placement = std::make_shared<SpoutPlacement>(services, spout.id, *spout.endpoint);
    services->arrivals[spout.id] = placement->arrivals();
    services->after_stop.emplace_back([services = services.get(), endpoint = *spout.endpoint] {
      ReadingGroup::clear_up(*services->registry, readers_path(endpoint, *services));
    });
    std::shared_ptr<DeadLetterSender> dead_letters;
    const std::string& topic = spout.endpoint->reading.dead_letter;
    if (!topic.empty()) dead_letters = std::make_shared<DeadLetterSender>(services, spout.id, topic);
    return [services, placement, dead_letters, endpoint = with_own_builder(*spout.endpoint)] {
      return std::make_unique<BrokerSpout>(services, placement, dead_letters, endpoint);
    };
  };
  factories.bolt = [services](const ComponentDefinition& bolt) -> BoltFactory {
    auto routes = std::make_shared<RouteTable>(services, bolt.id, *bolt.endpoint);
    services->before_stop.emplace_back([weak = std::weak_ptr(routes)] {
      if (const auto alive = weak.lock()) alive->end_grace();
    });
    return [services, routes, endpoint = with_own_builder(*bolt.endpoint)] {
      return std::make_unique<BrokerBolt>(services, routes, endpoint);
    };
  };
  return factories;
}

}  // namespace iotcloud::topology
