#pragma once

#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Tells frozen gateways (discovery/freeze.h) that the registry's orders are meant as they stand. For gateways that it
/// names, frozen or not, this master forgets which orders it gave last. Thread safe.
class Adoptions {
 public:
  explicit Adoptions(OrderDesk& desk) : desk_(desk) {}
  /// An outcome for each gateway: `done` when it is not frozen any more. \param selection no gateways: all that are
  /// frozen. Does not throw.
  OrderResult adopt(const GatewaySelection& selection);

 private:
  OrderResult adopt_all(const GatewaySelection& selection);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
