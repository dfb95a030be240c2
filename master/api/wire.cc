#include <algorithm>
#include <memory>

#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TMemoryBuffer;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;

namespace {

template <typename Struct>
std::string to_bytes(const Struct& value) {
  auto buffer = std::make_shared<TMemoryBuffer>();
  TBinaryProtocol protocol(buffer);
  value.write(&protocol);
  return buffer->getBufferAsString();
}

/// As long as an answer is waited for at most.
constexpr std::int64_t longest_drain_ms = 600'000;

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
    case Refusal::unknown_topology:
      return wire::TRefusal::UNKNOWN_TOPOLOGY;
  }
  return wire::TRefusal::BAD_REQUEST;
}

wire::TWorker to_wire(const discovery::WorkerRecord& worker) {
  wire::TWorker out;
  out.__set_name(worker.name);
  out.__set_host(worker.host);
  out.__set_pid(worker.pid);
  out.__set_http(worker.http);
  out.__set_state(worker.state);
  out.__set_revision(worker.revision);
  out.__set_error(worker.error);
  out.__set_sinceMs(worker.since_ms);
  for (const auto& [name, component] : worker.components) {
    wire::TComponentShape shape;
    shape.__set_parallelism(component.parallelism);
    shape.__set_tasks(component.tasks);
    out.components[name] = shape;
  }
  return out;
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

discovery::wire::TSite to_wire(const discovery::GatewayStatus& gateway) {
  auto site = to_wire(gateway.record);
  site.__set_alive(gateway.alive);
  site.__set_draining(gateway.draining);
  site.__set_original(gateway.original);
  return site;
}

wire::TOrder to_wire(const discovery::PlacedOrder& placed, bool with_secrets) {
  wire::TOrder out;
  out.__set_gateway(placed.gateway);
  out.__set_instance(placed.order.instance);
  out.__set_driver(placed.order.driver);
  out.__set_plugin(placed.order.plugin);
  for (const auto& [key, value] : placed.order.properties) {
    if (with_secrets || !is_secret(key, value)) {
      out.properties.emplace(key, value);
    } else {
      out.hidden.push_back(key);
    }
  }
  out.__set_metadata(placed.order.metadata);
  out.__set_active(placed.order.active || placed.order.drained);
  out.__set_name(placed.order.name);
  out.__set_index(placed.order.index);
  out.__set_manager(placed.order.manager);
  out.__set_sha256(placed.order.sha256);
  return out;
}

wire::TTopology to_wire(const discovery::TopologyStatus& topology) {
  wire::TTopology out;
  out.__set_name(topology.record.name);
  out.__set_sinceMs(topology.record.since_ms);
  out.__set_spouts(topology.record.spouts);
  out.__set_bolts(topology.record.bolts);
  for (const auto& worker : topology.workers) {
    out.workers.push_back(worker.name);
    out.workerRecords.push_back(to_wire(worker));
  }
  const bool killed = topology.order && topology.order->kill;
  const bool active = !topology.order || topology.order->active;
  out.__set_wanted(killed ? "killed" : active ? "active" : "inactive");
  out.__set_revision(topology.order ? topology.order->revision : 0);
  return out;
}

wire::TTopologyResponse to_wire(const TopologyResult& result) {
  wire::TTopologyResponse out;
  out.__set_response(result.all_done() ? success(result.summary()) : failure(result.summary()));
  out.__set_refusal(to_wire(result.refusal));
  if (!result.leader.empty()) out.__set_leader(result.leader);
  out.__set_text(result.text);
  for (const auto& outcome : result.outcomes) {
    wire::TWorkerOutcome one;
    one.__set_worker(outcome.worker);
    one.__set_host(outcome.host);
    one.__set_outcome(to_wire(outcome.outcome));
    one.__set_reason(outcome.reason);
    out.outcomes.push_back(std::move(one));
  }
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

wire::TUploadResponse to_wire(const UploadResult& result) {
  wire::TUploadResponse out;
  out.__set_response(result.refusal.refusal == Refusal::none ? success() : failure(result.refusal.text));
  out.__set_refusal(to_wire(result.refusal.refusal));
  if (!result.refusal.leader.empty()) out.__set_leader(result.refusal.leader);
  out.__set_upload(result.upload);
  for (const auto& target : result.targets) {
    wire::TPluginTarget one;
    one.__set_gateway(target.gateway);
    one.__set_problem(target.problem);
    one.__set_has(target.has);
    out.targets.push_back(std::move(one));
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
  out.name = request.name;
  out.indexes.assign(request.indexes.begin(), request.indexes.end());
  out.manager = request.manager;
  out.active = request.active;
  out.sha256 = request.sha256;
  return out;
}

DeploymentChange from_wire(const wire::TDeploymentChange& change) {
  DeploymentChange out;
  out.instances = change.instances;
  if (change.__isset.properties) out.properties = change.properties;
  if (change.__isset.manager) out.manager = change.manager;
  out.wait = wait_limit(change.waitMs);
  return out;
}

GatewaySelection from_wire(const wire::TGatewaySelection& selection) {
  return {selection.gateways, wait_limit(selection.waitMs)};
}

UpdateRequest from_wire(const wire::TUpdateRequest& request) {
  UpdateRequest out;
  out.selection = from_wire(request.selection);
  out.plugin = request.plugin;
  out.sha256 = request.sha256;
  out.at_once = request.atOnce;
  out.settle = std::chrono::milliseconds(std::max<std::int64_t>(0, request.settleMs));
  return out;
}

PluginOffer from_wire(const wire::TPluginOffer& offer) {
  return {offer.plugin, offer.sha256, offer.size, offer.signature};
}

InstanceSelection from_wire(const wire::TInstanceSelection& selection) {
  return {selection.instances, selection.gateways, wait_limit(selection.waitMs)};
}

TopologyRequest from_wire(const wire::TTopologyRequest& request) {
  TopologyRequest out;
  out.topology = request.topology;
  if (request.change < wire::TTopologyChange::ACTIVATE || request.change > wire::TTopologyChange::KILL)
    throw config::Error("this master does not know that change of a topology; it is older than the client");
  switch (request.change) {
    case wire::TTopologyChange::ACTIVATE:
      out.change = TopologyChange::activate;
      break;
    case wire::TTopologyChange::DEACTIVATE:
      out.change = TopologyChange::deactivate;
      break;
    case wire::TTopologyChange::REBALANCE:
      out.change = TopologyChange::rebalance;
      break;
    case wire::TTopologyChange::KILL:
      out.change = TopologyChange::kill;
      break;
  }
  for (const auto& [component, parallelism] : request.parallelism) out.parallelism[component] = parallelism;
  out.drain = std::chrono::milliseconds(std::clamp<std::int64_t>(request.drainMs, 0, longest_drain_ms));
  out.wait = wait_limit(request.waitMs);
  return out;
}

discovery::GatewayRecord from_wire(const discovery::wire::TSite& site) {
  return discovery::decode_gateway(to_bytes(site), "registerSite");
}

discovery::DriverRecord from_wire(const discovery::wire::TSensor& sensor) {
  return discovery::decode_driver(to_bytes(sensor), "registerSensor");
}

}  // namespace iotcloud::master
