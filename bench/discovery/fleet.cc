#include <cstdlib>
#include <functional>
#include <map>
#include <stdexcept>

#include <fmt/core.h>

#include <iotcloud/bench/discovery/fleet.h>

namespace iotcloud::bench {

FleetOptions parse_fleet_options(int argc, char** argv) {
  FleetOptions options;
  const std::map<std::string, std::function<void(const char*)>> values{
      {"--registry", [&](const char* text) { options.registry = text; }},
      {"--broker", [&](const char* text) { options.broker = text; }},
      {"--instances", [&](const char* text) { options.instances = std::atoi(text); }},
      {"--fresh", [&](const char* text) { options.fresh = std::atoi(text); }},
      {"--rest", [&](const char* text) { options.rest = std::atof(text); }},
      {"--server", [&](const char* text) { options.server.push_back(std::atoi(text)); }},
  };
  bool understood = true;
  for (int i = 1; i < argc; ++i) {
    if (std::string(argv[i]) == "--shared") {
      options.shared = true;
    } else if (const auto value = values.find(argv[i]); value != values.end() && i + 1 < argc) {
      value->second(argv[++i]);
    } else {
      understood = false;
    }
  }
  if (!understood || options.registry.empty() || options.instances < 1) {
    throw std::invalid_argument(
        "usage: PROGRAM --registry URL [--broker URL] [--instances N] [--fresh N] [--rest S] [--shared] "
        "[--server PID]...");
  }
  return options;
}

discovery::GatewayId Fleet::gateway(int instance) const {
  return discovery::GatewayId(instance < options_.instances ? fmt::format("gateway-{:02}", instance % gateways)
                                                            : fmt::format("gateway-of-{}", instance));
}

discovery::InstanceId Fleet::id(int instance) {
  return discovery::InstanceId(fmt::format("{:032x}", instance));
}

std::string Fleet::wire_name(int instance, const std::string& channel) const {
  return options_.shared ? fmt::format("{}.{}.{}", gateway(instance), driver, channel)
                         : fmt::format("{}.{}.{}.{}", gateway(instance), driver, id(instance), channel);
}

std::string Fleet::instance_path(int instance) const {
  return paths_.instance(discovery::DriverName(driver), id(instance));
}

std::string Fleet::queue(int instance, const std::string& topology) const {
  return wire_name(instance, "data") + "." + topology;
}

int Fleet::topics() const {
  return options_.shared ? std::min(options_.instances, gateways) : options_.instances;
}

std::vector<std::string> Fleet::parents() const {
  return {"/iot", "/iot/sensors", paths_.driver(discovery::DriverName(driver))};
}

discovery::ChannelRecord Fleet::channel(int instance, const std::string& name, discovery::Direction direction) const {
  discovery::ChannelRecord record;
  record.name = name;
  record.transport = "broker";
  record.direction = direction;
  record.properties = {{"exchange", "bench"}, {"routingKey", name}, {"queueName", name}};
  record.broker_url = options_.broker;
  record.gateway = gateway(instance);
  record.driver = discovery::DriverName(driver);
  record.instance = id(instance);
  record.shared = options_.shared;
  return record;
}

std::vector<std::pair<std::string, std::string>> Fleet::nodes(int instance) const {
  const auto data = channel(instance, "data", discovery::Direction::out);
  const auto control = channel(instance, "control", discovery::Direction::in);
  discovery::DriverRecord record;
  record.name = discovery::DriverName(driver);
  record.instance = data.instance;
  record.gateway = data.gateway;
  record.state = discovery::DriverState::active;
  record.channels = {data, control};
  const std::string path = instance_path(instance);
  return {{path, encode(record)}, {path + "/data", encode(data)}, {path + "/control", encode(control)}};
}

}  // namespace iotcloud::bench
