#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/master/orders/orders.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::master {

struct OrderServices;

/// The result of giving an order.
struct GivenOrder {
  std::string what;  ///< the order in words, for the audit log
  OrderResult result;
};

/// Called with the order in words before it is given; if it throws, the order is not given.
using BeforeOrder = std::function<void(const std::string& what)>;

/// One kind of order to driver instances, or one that submits topologies.
struct OrderKind {
  /// The name by which giveOrder takes it; if it has a method of its own in master.thrift, the name of that.
  std::string name;
  security::Role role;  ///< the least role that may give it
  /// Reads the order from JSON, whose fields are those of its struct in orders.h, and gives it.
  /// \throws config::Error when it cannot be read.
  std::function<GivenOrder(OrderServices& services, const std::string& json, const BeforeOrder& before)> give;
};

/// All kinds of orders to driver instances.
const std::vector<OrderKind>& order_kinds();
/// Finds a kind by its name; nullptr: there is none.
const OrderKind* find_order_kind(const std::string& name);

// The kinds that each service takes, defined in its own source.
std::vector<OrderKind> deployment_orders();
std::vector<OrderKind> change_orders();
std::vector<OrderKind> draining_orders();
std::vector<OrderKind> adoption_orders();
std::vector<OrderKind> forgetting_orders();
std::vector<OrderKind> backup_orders();
std::vector<OrderKind> update_orders();
std::vector<OrderKind> submission_orders();

}  // namespace iotcloud::master
