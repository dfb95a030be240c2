#pragma once

#include <chrono>
#include <string>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// Gateways that the master calls, because they do not follow orders in the registry: those of the original system.
/// Thread safe; no call throws.
class DirectGateways {
 public:
  virtual ~DirectGateways() = default;
  virtual bool has(const discovery::GatewayId& gateway) const = 0;
  /// Each call returns when the gateway has answered, or after `limit`. The original's gateway assigns the instance's
  /// id, so the outcome's `instance` may be empty.
  virtual InstanceOutcome deploy(const discovery::GatewayId& gateway, const DeployRequest& request,
                                 std::chrono::milliseconds limit) = 0;
  virtual InstanceOutcome change(const discovery::GatewayId& gateway, const discovery::InstanceId& instance,
                                 InstanceAction action, std::chrono::milliseconds limit) = 0;
};

}  // namespace iotcloud::master
