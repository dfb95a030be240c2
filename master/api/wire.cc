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
static_assert(static_cast<int>(OrderRefusal::not_allowed) == wire::TRefusal::NOT_ALLOWED);
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

ListedOrder listed(discovery::PlacedOrder placed, bool with_secrets) {
  ListedOrder result{std::move(placed), {}};
  auto& order = result.order;
  order.active = order.active || order.drained;
  if (with_secrets) return result;
  std::erase_if(order.properties, [&](const auto& property) {
    const bool hide = is_secret(property.first, property.second);
    if (hide) result.hidden.push_back(property.first);
    return hide;
  });
  return result;
}

wire::TOrderResponse to_wire(const OrderResult& result) {
  return answer_of<wire::TOrderResponse>(result, result.all_done());
}

OrderResult from_wire(wire::TOrderResponse answer) {
  auto result = as_own<OrderResult>(answer);
  if (result.refusal != OrderRefusal::none) result.text = std::move(answer.response.statusMessage);
  return result;
}

wire::TTopologyResponse to_wire(const TopologyResult& result) {
  return answer_of<wire::TTopologyResponse>(result, result.all_done());
}

TopologyResult from_wire(wire::TTopologyResponse answer) {
  auto result = as_own<TopologyResult>(answer);
  if (result.refusal != OrderRefusal::none) result.text = std::move(answer.response.statusMessage);
  return result;
}

wire::TUploadResponse to_wire(const UploadResult& result) {
  auto out = as_wire<wire::TUploadResponse>(result);
  out.__set_response(result.refusal.refusal == OrderRefusal::none ? success() : failure(result.refusal.text));
  return out;
}

UploadResult from_wire(wire::TUploadResponse answer) {
  auto result = as_own<UploadResult>(answer);
  result.refusal.text = std::move(answer.response.statusMessage);
  return result;
}

}  // namespace iotcloud::master
