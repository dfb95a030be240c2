// Writes the records of drivers that no gateway hosts, so that a topology worker reads and serves the queues of
// bench_brokers_rabbitmq's devices.
#include <cstdio>
#include <exception>
#include <map>
#include <stdexcept>
#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::bench {
namespace {

using Words = std::map<std::string, std::string>;

/// A channel of the driver with this number. Its exchange and topic are those of devices with the name "bench.NAME".
discovery::ChannelRecord channel(const Words& words, const std::string& number, const std::string& name,
                                 discovery::Direction direction) {
  const std::string& driver = words.at("--name");
  discovery::ChannelRecord record;
  record.name = name;
  record.transport = "rabbitmq";
  record.direction = direction;
  record.properties = {{"exchange", "bench." + driver}, {"routingKey", name}, {"queueName", name}};
  record.broker_url = words.at("--broker");
  record.gateway = discovery::GatewayId("bench");
  record.driver = discovery::DriverName(driver);
  record.instance = discovery::InstanceId(number);
  return record;
}

void write_records(const Words& words) {
  discovery::RegistryOptions options;
  options.url = words.at("--registry");
  const auto registry = discovery::make_registry(options);
  const discovery::Paths paths("/iot/sensors");
  for (int i = 0; i < std::stoi(words.at("--drivers")); ++i) {
    discovery::DriverRecord driver;
    driver.name = discovery::DriverName(words.at("--name"));
    driver.instance = discovery::InstanceId(std::to_string(i));
    driver.gateway = discovery::GatewayId("bench");
    driver.state = discovery::DriverState::active;
    driver.channels = {channel(words, driver.instance, "data", discovery::Direction::out),
                       channel(words, driver.instance, "control", discovery::Direction::in)};
    const std::string path = paths.instance(driver.name, driver.instance);
    registry->create(path, encode(driver));
    for (const discovery::ChannelRecord& one : driver.channels) registry->create(path + "/" + one.name, encode(one));
  }
}

Words parse(int argc, char** argv) {
  Words words;
  for (int i = 1; i + 1 < argc; i += 2) words[argv[i]] = argv[i + 1];
  for (const char* needed : {"--registry", "--broker", "--name", "--drivers"}) {
    if (words.count(needed) == 0) {
      throw std::invalid_argument("usage: PROGRAM --registry URL --broker URL --name PREFIX --drivers N");
    }
  }
  return words;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  try {
    iotcloud::bench::write_records(iotcloud::bench::parse(argc, argv));
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
