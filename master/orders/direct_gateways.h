#pragma once

#include <chrono>
#include <string>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// Gateways that follow no orders in the registry and are called instead: those of the original system.
/// Thread safe; no call throws.
class DirectGateways {
 public:
  virtual ~DirectGateways() = default;
  virtual bool has(const std::string& gateway) const = 0;
  /// Each returns when the gateway has answered, or after `limit`.
  /// The original's gateway gives the instance its id, so the outcome's `instance` may be empty.
  virtual InstanceOutcome deploy(const std::string& gateway, const DeployRequest& request,
                                 std::chrono::milliseconds limit) = 0;
  virtual InstanceOutcome change(const std::string& gateway, const std::string& instance, Change change,
                                 std::chrono::milliseconds limit) = 0;
};

}  // namespace iotcloud::master
