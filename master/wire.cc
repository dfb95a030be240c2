#include <memory>

#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/master/wire.h>

namespace iotcloud::master {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TMemoryBuffer;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;

namespace {

template <typename Struct>
Struct parse(const std::string& bytes) {
  auto buffer = std::make_shared<TMemoryBuffer>();
  buffer->write(reinterpret_cast<const std::uint8_t*>(bytes.data()), static_cast<std::uint32_t>(bytes.size()));
  TBinaryProtocol protocol(buffer);
  Struct value;
  value.read(&protocol);
  return value;
}

template <typename Struct>
std::string to_bytes(const Struct& value) {
  auto buffer = std::make_shared<TMemoryBuffer>();
  TBinaryProtocol protocol(buffer);
  value.write(&protocol);
  return buffer->getBufferAsString();
}

WaitLimit wait_limit(std::int64_t ms) {
  if (ms <= 0) return std::nullopt;
  return std::chrono::milliseconds(ms);
}

wire::TOutcome::type to_wire(Outcome outcome) {
  switch (outcome) {
    case Outcome::done:
      return wire::TOutcome::DONE;
    case Outcome::failed:
      return wire::TOutcome::FAILED;
    case Outcome::pending:
      return wire::TOutcome::PENDING;
    case Outcome::unknown:
      return wire::TOutcome::UNKNOWN;
  }
  return wire::TOutcome::UNKNOWN;
}

wire::TRefusal::type to_wire(Refusal refusal) {
  switch (refusal) {
    case Refusal::none:
      return wire::TRefusal::NONE;
    case Refusal::not_leading:
      return wire::TRefusal::NOT_LEADING;
    case Refusal::unknown_gateway:
      return wire::TRefusal::UNKNOWN_GATEWAY;
    case Refusal::unknown_instance:
      return wire::TRefusal::UNKNOWN_INSTANCE;
    case Refusal::bad_request:
      return wire::TRefusal::BAD_REQUEST;
    case Refusal::registry_away:
      return wire::TRefusal::REGISTRY_AWAY;
  }
  return wire::TRefusal::BAD_REQUEST;
}

}  // namespace

TResponse success(const std::string& text) {
  TResponse response;
  response.__set_state(TResponseState::SUCCESS);
  response.__set_statusMessage(text);
  return response;
}

TResponse failure(const std::string& text) {
  TResponse response;
  response.__set_state(TResponseState::FAILURE);
  response.__set_statusMessage(text);
  return response;
}

TResponse to_response(const OrderResult& result) {
  return result.all_done() ? success(result.summary()) : failure(result.summary());
}

discovery::wire::TSensor to_wire(const discovery::DriverRecord& record) {
  auto sensor = parse<discovery::wire::TSensor>(encode(record));
  sensor.channels.clear();
  for (const auto& channel : record.channels)
    sensor.channels.push_back(parse<discovery::wire::TChannel>(encode(channel)));
  return sensor;
}

discovery::wire::TSite to_wire(const discovery::GatewayStatus& gateway) {
  auto site = parse<discovery::wire::TSite>(encode(gateway.record));
  site.__set_alive(gateway.alive);
  return site;
}

wire::TTopology to_wire(const discovery::TopologyStatus& topology) {
  wire::TTopology out;
  out.__set_name(topology.record.name);
  out.__set_sinceMs(topology.record.since_ms);
  out.__set_spouts(topology.record.spouts);
  out.__set_bolts(topology.record.bolts);
  out.__set_workers(topology.workers);
  return out;
}

wire::TOrderResponse to_wire(const OrderResult& result) {
  wire::TOrderResponse out;
  out.__set_response(to_response(result));
  out.__set_refusal(to_wire(result.refusal));
  if (!result.leader.empty()) out.__set_leader(result.leader);
  for (const auto& outcome : result.outcomes) {
    wire::TInstanceOutcome one;
    one.__set_gateway(outcome.gateway);
    one.__set_instance(outcome.instance);
    one.__set_outcome(to_wire(outcome.outcome));
    one.__set_reason(outcome.reason);
    out.outcomes.push_back(std::move(one));
  }
  return out;
}

DeployRequest from_wire(const wire::TDeployRequest& request) {
  DeployRequest out;
  out.gateways = request.gateways;
  out.plugin = request.plugin;
  out.driver = request.driver;
  out.properties = request.properties;
  out.metadata = request.metadata;
  out.count = request.count;
  out.wait = wait_limit(request.waitMs);
  return out;
}

InstanceSelection from_wire(const wire::TInstanceSelection& selection) {
  return {selection.instances, selection.gateways, wait_limit(selection.waitMs)};
}

discovery::GatewayRecord from_wire(const discovery::wire::TSite& site) {
  return discovery::decode_gateway(to_bytes(site), "registerSite");
}

discovery::DriverRecord from_wire(const discovery::wire::TSensor& sensor) {
  return discovery::decode_driver(to_bytes(sensor), "registerSensor");
}

}  // namespace iotcloud::master
