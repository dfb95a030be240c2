#pragma once

#include <cstddef>
#include <string_view>

#include <iotcloud/discovery/ids.h>

/// Ids as tests write them: "lab1"_gateway.
namespace iotcloud {

inline discovery::GatewayId operator""_gateway(const char* text, std::size_t size) {
  return discovery::GatewayId(std::string_view(text, size));
}
inline discovery::InstanceId operator""_instance(const char* text, std::size_t size) {
  return discovery::InstanceId(std::string_view(text, size));
}
inline discovery::DriverName operator""_driver(const char* text, std::size_t size) {
  return discovery::DriverName(std::string_view(text, size));
}
inline discovery::TopologyName operator""_topology(const char* text, std::size_t size) {
  return discovery::TopologyName(std::string_view(text, size));
}

}  // namespace iotcloud
