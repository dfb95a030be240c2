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
/// An order as clients may see it, in which `active` is what is wanted when its gateway does not drain.
/// \param with_secrets whether values of properties that look like secrets are included; else only their keys are.
ListedOrder listed(discovery::PlacedOrder placed, bool with_secrets);
wire::TOrderResponse to_wire(const OrderResult& result);
wire::TUploadResponse to_wire(const UploadResult& result);
wire::TTopologyResponse to_wire(const TopologyResult& result);
discovery::wire::TResponse to_response(const OrderResult& result);

discovery::wire::TResponse success(const std::string& text = "");
discovery::wire::TResponse failure(const std::string& text);

OrderResult from_wire(wire::TOrderResponse answer);
UploadResult from_wire(wire::TUploadResponse answer);
TopologyResult from_wire(wire::TTopologyResponse answer);

}  // namespace iotcloud::master
