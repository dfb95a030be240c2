#pragma once

#include <string>

#include "iotcloud/master/master_types.h"
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/discovery/wire_records.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/master/topologies/topology_orders.h>

/// Converts our structs to the API's Thrift structs, and back, where discovery::as_wire() and as_own() are not enough.
namespace iotcloud::master {

/// A driver as every caller may see it: without the passwords in its channels' broker URLs and properties.
discovery::wire::TSensor without_secrets(const discovery::DriverRecord& driver);
discovery::wire::TSite to_wire(const discovery::GatewayStatus& gateway);
wire::TTopology to_wire(const discovery::TopologyStatus& topology);
/// \param with_secrets whether values of properties that look like secrets are included; else only their keys are.
wire::TOrder to_wire(const discovery::PlacedOrder& placed, bool with_secrets);
wire::TOrderResponse to_wire(const OrderResult& result);
wire::TUploadResponse to_wire(const UploadResult& result);
wire::TTopologyResponse to_wire(const TopologyResult& result);
discovery::wire::TResponse to_response(const OrderResult& result);

discovery::wire::TResponse success(const std::string& text = "");
discovery::wire::TResponse failure(const std::string& text);

discovery::GatewayStatus from_wire(discovery::wire::TSite site);
discovery::TopologyStatus from_wire(wire::TTopology topology);
ListedOrder from_wire(wire::TOrder order);
OrderResult from_wire(wire::TOrderResponse answer);
UploadResult from_wire(wire::TUploadResponse answer);
TopologyResult from_wire(wire::TTopologyResponse answer);

}  // namespace iotcloud::master
