#include <algorithm>
#include <memory>
#include <utility>

#include <nlohmann/json.hpp>
#include <thrift/TConfiguration.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/wire_records.h>

namespace iotcloud::discovery {
namespace {

using apache::thrift::TConfiguration;
using apache::thrift::transport::TMemoryBuffer;
using Protocol = apache::thrift::protocol::TBinaryProtocolT<TMemoryBuffer>;

/// Thrift makes room for all elements that a list announces before it reads one; no record has nearly as many.
constexpr std::int32_t container_limit = 4096;

template <typename Struct>
std::string to_bytes(const Struct& value) {
  auto buffer = std::make_shared<TMemoryBuffer>();
  Protocol protocol(buffer);
  value.write(&protocol);
  return buffer->getBufferAsString();
}

/// \param what for the message: "a driver (TSensor)".
template <typename Struct>
Struct from_bytes(const std::string& bytes, const std::string& path, const std::string& what) {
  const auto fail = [&](const std::string& problem) {
    return config::Error(path + ": the " + std::to_string(bytes.size()) + " bytes are not " + what +
                         " in Thrift's binary protocol: " + problem);
  };
  try {
    const int size = static_cast<int>(std::min<std::size_t>(bytes.size(), 1 << 30));
    auto settings = std::make_shared<TConfiguration>(std::max(size, 1));
    // The buffer is only read: OBSERVE keeps Thrift from copying or writing it, its parameter is not const all the
    // same.
    auto buffer = std::make_shared<TMemoryBuffer>(const_cast<std::uint8_t*>(  // NOLINT
                                                      reinterpret_cast<const std::uint8_t*>(bytes.data())),
                                                  static_cast<std::uint32_t>(size), TMemoryBuffer::OBSERVE, settings);
    Protocol protocol(buffer, std::max(size, 1), container_limit, false, true);
    Struct value;
    value.read(&protocol);
    if (buffer->available_read() != 0) throw fail(std::to_string(buffer->available_read()) + " bytes too many");
    return value;
  } catch (const config::Error&) {
    throw;
  } catch (const std::exception& error) {
    throw fail(error.what());
  }
}

/// What a program of the original makes of a state. Its topologies read an instance's channels when they see DEPLOY
/// and stop at UN_DEPLOY; its gateways say DEPLOY of an instance that runs and never ACTIVE (REFERENCE.md 2).
wire::TSensorState::type to_wire(DriverState state) {
  switch (state) {
    case DriverState::active:
      return wire::TSensorState::DEPLOY;
    case DriverState::deployed:
    case DriverState::starting:
    case DriverState::stopping:
    case DriverState::inactive:
    case DriverState::failed:
      return wire::TSensorState::DE_ACTIVATE;
    case DriverState::undeployed:
      return wire::TSensorState::UN_DEPLOY;
  }
  return wire::TSensorState::UNKNOWN;
}

DriverState from_wire(const wire::TSensor& sensor) {
  if (sensor.__isset.exactState) {
    try {
      return parse_driver_state(sensor.exactState);
    } catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): a newer program's word; the nearest one follows
    }
  }
  switch (sensor.state) {
    case wire::TSensorState::DEPLOY:
    case wire::TSensorState::ACTIVE:
    case wire::TSensorState::UPDATE:
      return DriverState::active;
    case wire::TSensorState::UN_DEPLOY:
      return DriverState::undeployed;
    case wire::TSensorState::DE_ACTIVATE:
    case wire::TSensorState::UNKNOWN:
      return DriverState::inactive;
  }
  return DriverState::inactive;
}

wire::TChannel to_wire(const ChannelRecord& record) {
  wire::TChannel channel;
  channel.transport = record.transport;
  channel.direction = record.direction == Direction::in ? wire::TDirection::IN : wire::TDirection::OUT;
  channel.__set_properties(record.properties);
  channel.__set_brokerUrl(record.broker_url);
  channel.__set_name(record.name);
  channel.__set_site(record.gateway);
  channel.__set_sensor(record.driver);
  channel.__set_grouped(record.shared);
  channel.__set_sensorId(record.instance);
  return channel;
}

ChannelRecord from_wire(wire::TChannel&& channel, const std::string& path) {
  if (channel.direction != wire::TDirection::IN && channel.direction != wire::TDirection::OUT) {
    throw config::Error(path + ": the channel's direction is neither 0 (in) nor 1 (out)");
  }
  ChannelRecord record;
  record.name = std::move(channel.name);
  record.transport = std::move(channel.transport);
  record.direction = channel.direction == wire::TDirection::IN ? Direction::in : Direction::out;
  record.properties = std::move(channel.properties);
  record.broker_url = std::move(channel.brokerUrl);
  record.gateway = std::move(channel.site);
  record.driver = std::move(channel.sensor);
  record.instance = std::move(channel.sensorId);
  record.shared = channel.grouped;
  return record;
}

std::string metadata_to_json(const std::map<std::string, std::string>& metadata) {
  return nlohmann::json(metadata).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// Gateways of the original put anything here: what is no JSON object of strings is not an error, only not ours.
std::map<std::string, std::string> metadata_from_json(const std::string& text) {
  std::map<std::string, std::string> metadata;
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) return metadata;
  for (const auto& [key, value] : json.items()) {
    if (value.is_string()) metadata.emplace(key, value.get<std::string>());
  }
  return metadata;
}

constexpr std::pair<DriverState, const char*> state_names[] = {
    {DriverState::deployed, "deployed"},    {DriverState::starting, "starting"}, {DriverState::active, "active"},
    {DriverState::stopping, "stopping"},    {DriverState::inactive, "inactive"}, {DriverState::failed, "failed"},
    {DriverState::undeployed, "undeployed"}};

}  // namespace

std::string to_string(DriverState state) {
  for (const auto& [value, name] : state_names) {
    if (value == state) return name;
  }
  return "unknown";
}

DriverState parse_driver_state(const std::string& name) {
  std::string known;
  for (const auto& [value, word] : state_names) {
    if (name == word) return value;
    known += known.empty() ? word : std::string(", ") + word;
  }
  throw config::Error("\"" + name + "\" is no driver state; there are: " + known);
}

wire::TSensor to_wire(const DriverRecord& record) {
  wire::TSensor sensor;
  sensor.name = record.name;
  sensor.siteId = record.gateway;
  sensor.state = to_wire(record.state);
  sensor.metadata = metadata_to_json(record.metadata);
  for (const ChannelRecord& channel : record.channels) sensor.channels.push_back(to_wire(channel));
  sensor.__set_sensorId(record.instance);
  sensor.__set_exactState(to_string(record.state));
  sensor.__set_reason(record.reason);
  sensor.__set_sinceMs(record.since_ms);
  if (!record.deployment.empty()) {
    sensor.__set_deployment(record.deployment);
    sensor.__set_index(record.index);
  }
  if (!record.plugin.empty()) sensor.__set_plugin(record.plugin);
  if (!record.sha256.empty()) sensor.__set_sha256(record.sha256);
  if (!record.signed_by.empty()) sensor.__set_signedBy(record.signed_by);
  return sensor;
}

std::string encode(const DriverRecord& record) {
  return to_bytes(to_wire(record));
}

DriverRecord decode_driver(const std::string& bytes, const std::string& path) {
  auto sensor = from_bytes<wire::TSensor>(bytes, path, "a driver (TSensor)");
  DriverRecord record;
  record.state = from_wire(sensor);
  record.name = std::move(sensor.name);
  record.instance = std::move(sensor.sensorId);
  record.gateway = std::move(sensor.siteId);
  record.reason = std::move(sensor.reason);
  record.since_ms = sensor.sinceMs;
  record.deployment = std::move(sensor.deployment);
  record.index = sensor.index;
  record.plugin = std::move(sensor.plugin);
  record.sha256 = std::move(sensor.sha256);
  record.signed_by = std::move(sensor.signedBy);
  record.metadata = metadata_from_json(sensor.metadata);
  for (wire::TChannel& channel : sensor.channels) record.channels.push_back(from_wire(std::move(channel), path));
  return record;
}

std::string encode(const ChannelRecord& record) {
  return to_bytes(to_wire(record));
}

ChannelRecord decode_channel(const std::string& bytes, const std::string& path) {
  return from_wire(from_bytes<wire::TChannel>(bytes, path, "a channel (TChannel)"), path);
}

wire::TSite to_wire(const GatewayRecord& record) {
  wire::TSite site;
  site.siteId = record.id;
  site.port = record.port;
  site.host = record.host;
  std::vector<wire::TBroker> brokers(record.brokers.size());
  for (std::size_t i = 0; i < brokers.size(); ++i) brokers[i].name = record.brokers[i];
  site.__set_brokers(brokers);
  site.__set_sinceMs(record.since_ms);
  if (record.tls) site.__set_tls(true);
  return site;
}

std::string encode(const GatewayRecord& record) {
  return to_bytes(to_wire(record));
}

GatewayRecord decode_gateway(const std::string& bytes, const std::string& path) {
  auto site = from_bytes<wire::TSite>(bytes, path, "a gateway (TSite)");
  GatewayRecord record;
  record.id = std::move(site.siteId);
  record.host = std::move(site.host);
  record.port = site.port;
  for (wire::TBroker& broker : site.brokers) record.brokers.push_back(std::move(broker.name));
  record.since_ms = site.sinceMs;
  record.tls = site.__isset.tls && site.tls;
  return record;
}

}  // namespace iotcloud::discovery
