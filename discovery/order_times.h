#pragma once

#include <chrono>
#include <cstdint>

#include <iotcloud/discovery/registry.h>

/// By which times an old order is told from the last one. Each order says when a master gave it (`given_ms`).
namespace iotcloud::discovery {

/// How far the clocks of masters, gateways, workers and the registry may differ.
inline constexpr std::chrono::milliseconds clocks_differ = std::chrono::minutes(10);

/// Whether an order was written to the registry so long after a master gave it that somebody wrote an old one once
/// more.
inline bool written_late(const Node& node, std::int64_t given_ms) {
  return node.modified_ms - given_ms > clocks_differ.count();
}

}  // namespace iotcloud::discovery
