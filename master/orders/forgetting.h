#pragma once

#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Removes lost gateways that do not come back from the registry. Thread safe.
class Forgetting {
 public:
  explicit Forgetting(OrderDesk& desk) : desk_(desk) {}
  /// An outcome for each gateway: `done` when its record, its orders and the records of its instances are gone,
  /// `failed` when it is alive. \param selection at least one gateway; its `wait` is not used. Does not throw.
  OrderResult forget(const GatewaySelection& selection);

 private:
  OrderResult forget_all(const GatewaySelection& selection);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
