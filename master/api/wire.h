#pragma once

#include "iotcloud/master/master_types.h"
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/wire_records.h>
#include <iotcloud/master/orders/orders.h>
#include <iotcloud/master/plugins/plugin_uploads.h>
#include <iotcloud/master/topologies/topology_orders.h>

/// Between the master's own types and those that cross Thrift. Private to the server's sources: heavy to include.
namespace iotcloud::master {

using discovery::to_wire;
discovery::wire::TSite to_wire(const discovery::GatewayStatus& gateway);
wire::TTopology to_wire(const discovery::TopologyStatus& topology);
/// \param with_secrets all properties; else those that look like secrets are named only.
wire::TOrder to_wire(const discovery::PlacedOrder& placed, bool with_secrets);
wire::TOrderResponse to_wire(const OrderResult& result);
wire::TUploadResponse to_wire(const UploadResult& result);
wire::TTopologyResponse to_wire(const TopologyResult& result);
discovery::wire::TResponse to_response(const OrderResult& result);

discovery::wire::TResponse success(const std::string& text = "");
discovery::wire::TResponse failure(const std::string& text);

DeployRequest from_wire(const wire::TDeployRequest& request);
InstanceSelection from_wire(const wire::TInstanceSelection& selection);
DeploymentChange from_wire(const wire::TDeploymentChange& change);
GatewaySelection from_wire(const wire::TGatewaySelection& selection);
UpdateRequest from_wire(const wire::TUpdateRequest& request);
PluginOffer from_wire(const wire::TPluginOffer& offer);
TopologyRequest from_wire(const wire::TTopologyRequest& request);
/// \throws config::Error when there is something in them that cannot be.
discovery::GatewayRecord from_wire(const discovery::wire::TSite& site);
discovery::DriverRecord from_wire(const discovery::wire::TSensor& sensor);

}  // namespace iotcloud::master
