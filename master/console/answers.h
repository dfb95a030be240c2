#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/discovery/channel_look.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/master/topologies/topology_orders.h>

/// What the console's page is answered, and what it asks, as JSON.
namespace iotcloud::master {

/// {"done", "refused", "leader", "summary", "outcomes": [...]}
std::string answer_of(const OrderResult& result);
std::string answer_of(const TopologyResult& result);
std::string answer_of(const DriverHistory& history);
std::string answer_of(const GatewayPlugins& plugins);
/// Payloads are base64.
std::string answer_of(discovery::ChannelLook look);

/// The arguments of a call. \throws config::Error when the text is no JSON object
nlohmann::json read_arguments(const std::string& call, const std::string& json);
/// A text among the arguments; empty: it is not there. \throws config::Error when it is something else
std::string text_of(const nlohmann::json& arguments, const char* key);
std::vector<std::string> texts_of(const nlohmann::json& arguments, const char* key);
/// Of {"topology", "change", "parallelism"}. \throws config::Error
TopologyRequest read_topology_order(const nlohmann::json& arguments);

}  // namespace iotcloud::master
