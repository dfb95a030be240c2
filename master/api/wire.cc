#include <utility>

#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master {

using discovery::as_own;
using discovery::as_wire;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;

// Our enumerations go over the wire as their numbers, which must be those of Thrift's enumerations.
static_assert(static_cast<int>(OrderOutcome::unknown) == wire::TOutcome::UNKNOWN);
static_assert(static_cast<int>(Refusal::not_allowed) == wire::TRefusal::NOT_ALLOWED);
static_assert(static_cast<int>(TopologyChange::kill) == wire::TTopologyChange::KILL);

namespace {

/// Converts an answer, and fills its `response` with the text for people.
template <typename Wire, typename Result>
Wire answer_of(const Result& result, bool good) {
  auto answer = as_wire<Wire>(result);
  answer.__set_response(good ? success(result.summary()) : failure(result.summary()));
  return answer;
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

discovery::wire::TSensor without_secrets(const discovery::DriverRecord& driver) {
  auto sensor = discovery::to_wire(driver);
  for (auto& channel : sensor.channels) {
    if (channel.__isset.brokerUrl) channel.brokerUrl = without_password(channel.brokerUrl);
    for (auto& [key, value] : channel.properties) {
      if (is_secret(key, value)) value = "***";
    }
  }
  return sensor;
}

discovery::wire::TSite to_wire(const discovery::GatewayStatus& gateway) {
  auto site = discovery::to_wire(gateway.record);
  site.__set_alive(gateway.alive);
  site.__set_draining(gateway.draining);
  site.__set_original(gateway.original);
  if (!gateway.frozen.empty()) site.__set_frozen(gateway.frozen);
  return site;
}

discovery::GatewayStatus from_wire(discovery::wire::TSite site) {
  discovery::GatewayStatus gateway;
  gateway.alive = site.alive;
  gateway.draining = site.draining;
  gateway.original = site.original;
  gateway.frozen = site.frozen;
  gateway.record = discovery::from_wire(std::move(site));
  return gateway;
}

wire::TOrder to_wire(const discovery::PlacedOrder& placed, bool with_secrets) {
  wire::TOrder out;
  discovery::fill_wire<discovery::Deployment>(placed.order, out);
  out.__set_gateway(placed.gateway);
  out.__set_instance(placed.order.instance);
  out.__set_index(placed.order.index);
  out.__set_active(placed.order.active || placed.order.drained);
  if (with_secrets) return out;
  std::erase_if(out.properties, [&](const auto& property) {
    const bool hide = is_secret(property.first, property.second);
    if (hide) out.hidden.push_back(property.first);
    return hide;
  });
  return out;
}

ListedOrder from_wire(wire::TOrder order) {
  ListedOrder listed;
  listed.gateway = discovery::GatewayId(std::move(order.gateway));
  listed.order.instance = discovery::InstanceId(std::move(order.instance));
  listed.order.index = order.index;
  listed.hidden = std::move(order.hidden);
  discovery::fill_own<wire::TOrder, discovery::Deployment>(order, listed.order);
  return listed;
}

wire::TTopology to_wire(const discovery::TopologyStatus& topology) {
  auto out = as_wire<wire::TTopology>(topology.record);
  for (const auto& worker : topology.workers) {
    out.workers.push_back(worker.name);
    discovery::fill_wire(worker, out.workerRecords.emplace_back());
  }
  const bool killed = topology.order && topology.order->kill;
  const bool active = !topology.order || topology.order->active;
  out.__set_wanted(killed ? "killed" : active ? "active" : "inactive");
  out.__set_revision(topology.order ? topology.order->revision : 0);
  return out;
}

discovery::TopologyStatus from_wire(wire::TTopology topology) {
  discovery::TopologyStatus status;
  for (auto& worker : topology.workerRecords) discovery::fill_own(worker, status.workers.emplace_back());
  auto& order = status.order.emplace();
  order.revision = topology.revision;
  order.active = topology.wanted == "active";
  if (topology.wanted == "killed") order.kill.emplace();
  discovery::fill_own(topology, status.record);
  return status;
}

wire::TOrderResponse to_wire(const OrderResult& result) {
  return answer_of<wire::TOrderResponse>(result, result.all_done());
}

OrderResult from_wire(wire::TOrderResponse answer) {
  auto result = as_own<OrderResult>(answer);
  if (result.refusal != Refusal::none) result.text = std::move(answer.response.statusMessage);
  return result;
}

wire::TTopologyResponse to_wire(const TopologyResult& result) {
  return answer_of<wire::TTopologyResponse>(result, result.all_done());
}

TopologyResult from_wire(wire::TTopologyResponse answer) {
  auto result = as_own<TopologyResult>(answer);
  if (result.refusal != Refusal::none) result.text = std::move(answer.response.statusMessage);
  return result;
}

wire::TUploadResponse to_wire(const UploadResult& result) {
  auto out = as_wire<wire::TUploadResponse>(result);
  out.__set_response(result.refusal.refusal == Refusal::none ? success() : failure(result.refusal.text));
  return out;
}

UploadResult from_wire(wire::TUploadResponse answer) {
  auto result = as_own<UploadResult>(answer);
  result.refusal.text = std::move(answer.response.statusMessage);
  return result;
}

}  // namespace iotcloud::master
