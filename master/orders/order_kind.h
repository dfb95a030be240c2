#pragma once

#include <string>
#include <utility>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/orders/order_kinds.h>
#include <iotcloud/master/orders/order_services.h>

namespace iotcloud::master {

/// Makes the kind of order that has `Order` as its struct. \param give takes (OrderServices&, const Order&) and returns
/// an OrderResult. For sources only: heavy to include.
template <discovery::Described Order, typename Give>
OrderKind order_kind(std::string name, security::Role role, Give give) {
  return {name, role,
          [name, give = std::move(give)](OrderServices& services, const std::string& json, const BeforeOrder& before) {
            const auto order = discovery::from_text<Order>(json, name);
            auto what = words(order);
            if (before) before(what);
            return GivenOrder{std::move(what), give(services, order)};
          }};
}

}  // namespace iotcloud::master
