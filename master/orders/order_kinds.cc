#include <algorithm>

#include <iotcloud/master/orders/order_kinds.h>

namespace iotcloud::master {

const std::vector<OrderKind>& order_kinds() {
  static const std::vector<OrderKind> all = [] {
    std::vector<OrderKind> kinds;
    for (const auto& of_service : {deployment_orders(), change_orders(), draining_orders(), adoption_orders(),
                                   forgetting_orders(), backup_orders(), update_orders(), submission_orders()})
      kinds.insert(kinds.end(), of_service.begin(), of_service.end());
    return kinds;
  }();
  return all;
}

const OrderKind* find_order_kind(const std::string& name) {
  const auto& all = order_kinds();
  const auto at = std::find_if(all.begin(), all.end(), [&](const auto& kind) { return kind.name == name; });
  return at == all.end() ? nullptr : &*at;
}

}  // namespace iotcloud::master
