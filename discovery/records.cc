#include <algorithm>
#include <memory>
#include <utility>

#include <nlohmann/json.hpp>
#include <thrift/TConfiguration.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/discovery/description/words.h>
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

/// \param what names the record in error messages: "a driver (TSensor)".
template <typename Struct>
Struct from_bytes(const std::string& bytes, const std::string& path, const std::string& what) {
  const auto fail = [&](const std::string& problem) {
    return config::Error(path + ": the " + std::to_string(bytes.size()) + " bytes are not " + what +
                         " in Thrift's binary protocol: " + problem);
  };
  try {
    const int size = static_cast<int>(std::min<std::size_t>(bytes.size(), 1 << 30));
    auto settings = std::make_shared<TConfiguration>(std::max(size, 1));
    // With OBSERVE Thrift neither copies the buffer nor writes to it, although its parameter is not const.
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

/// The state of the original system that makes its programs do the right thing. Its topologies read an instance's
/// channels when they see DEPLOY and stop at UN_DEPLOY; its gateways say DEPLOY of an instance that runs and never
/// ACTIVE (docs/wire.md#driver-states).
wire::TSensorState::type to_wire(DriverState state) {
  switch (state) {
    case DriverState::active:
      return wire::TSensorState::DEPLOY;
    case DriverState::deployed:
    case DriverState::starting:
    case DriverState::stopping:
    case DriverState::inactive:
    case DriverState::failed:
    case DriverState::ordered:
      return wire::TSensorState::DE_ACTIVATE;
    case DriverState::undeployed:
      return wire::TSensorState::UN_DEPLOY;
  }
  return wire::TSensorState::UNKNOWN;
}

DriverState state_of(const wire::TSensor& sensor) {
  if (sensor.__isset.exactState) {
    try {
      return parse_driver_state(sensor.exactState);
    } catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): a newer program's state; the nearest one follows
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

void check_direction(const wire::TChannel& channel, const std::string& path) {
  if (channel.direction == wire::TDirection::IN || channel.direction == wire::TDirection::OUT) return;
  throw config::Error(path + ": the channel's direction is neither 0 (in) nor 1 (out)");
}

std::string metadata_to_json(const std::map<std::string, std::string>& metadata) {
  return nlohmann::json(metadata).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// Gateways of the original write any text here, so text that is no JSON object of strings is not an error; it is
/// ignored.
std::map<std::string, std::string> metadata_from_json(const std::string& text) {
  std::map<std::string, std::string> metadata;
  nlohmann::json json;
  try {
    json = parse_json(text, "metadata");
  } catch (const config::Error&) {
    return metadata;
  }
  if (!json.is_object()) return metadata;
  for (const auto& [key, value] : json.items()) {
    if (value.is_string()) metadata.emplace(key, value.get<std::string>());
  }
  return metadata;
}

constexpr Word<DriverState> state_names[] = {
    {DriverState::deployed, "deployed"},     {DriverState::starting, "starting"}, {DriverState::active, "active"},
    {DriverState::stopping, "stopping"},     {DriverState::inactive, "inactive"}, {DriverState::failed, "failed"},
    {DriverState::undeployed, "undeployed"}, {DriverState::ordered, "ordered"}};

}  // namespace

std::string to_string(DriverState state) {
  return word_of(state, state_names);
}

DriverState parse_driver_state(const std::string& name) {
  return value_named(name, state_names, "driver state");
}

wire::TSensor to_wire(const DriverRecord& record) {
  auto sensor = as_wire<wire::TSensor>(record);
  sensor.state = to_wire(record.state);
  sensor.__set_exactState(to_string(record.state));
  sensor.metadata = metadata_to_json(record.metadata);
  return sensor;
}

DriverRecord from_wire(wire::TSensor sensor, const std::string& path) {
  for (const auto& channel : sensor.channels) check_direction(channel, path);
  DriverRecord record;
  record.state = state_of(sensor);
  record.metadata = metadata_from_json(sensor.metadata);
  fill_own(sensor, record);
  return record;
}

std::vector<AsBrokers::Broker> AsBrokers::to(const std::vector<std::string>& names) {
  std::vector<Broker> brokers;
  brokers.reserve(names.size());
  for (const auto& name : names) brokers.push_back({name});
  return brokers;
}

void AsBrokers::from(std::vector<Broker> brokers, std::vector<std::string>& names) {
  names.clear();
  for (auto& broker : brokers) names.push_back(std::move(broker.name));
}

std::string encode(const DriverRecord& record) {
  return to_bytes(to_wire(record));
}
std::string encode(const ChannelRecord& record) {
  return to_bytes(as_wire<wire::TChannel>(record));
}
std::string encode(const GatewayRecord& record) {
  return to_bytes(as_wire<wire::TSite>(record));
}

DriverRecord decode_driver(const std::string& bytes, const std::string& path) {
  return from_wire(from_bytes<wire::TSensor>(bytes, path, "a driver (TSensor)"), path);
}
ChannelRecord decode_channel(const std::string& bytes, const std::string& path) {
  auto channel = from_bytes<wire::TChannel>(bytes, path, "a channel (TChannel)");
  check_direction(channel, path);
  return as_own<ChannelRecord>(std::move(channel));
}
GatewayRecord decode_gateway(const std::string& bytes, const std::string& path) {
  return as_own<GatewayRecord>(from_bytes<wire::TSite>(bytes, path, "a gateway (TSite)"));
}

}  // namespace iotcloud::discovery
