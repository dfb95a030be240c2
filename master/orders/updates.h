#pragma once

#include <set>
#include <string>

#include <iotcloud/config/mutex.h>
#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// The instances of which an update is under way.
struct InstancesUnderUpdate {
  config::Mutex mutex;
  std::set<discovery::InstanceId> ids IOTCLOUD_GUARDED_BY(mutex);
};

/// Rolling updates: change instances step by step, and roll all of them back when a step fails. Thread safe.
class Updates {
 public:
  explicit Updates(OrderDesk& desk) : desk_(desk) {}
  /// Does not throw.
  OrderResult update(const UpdateRequest& request);

 private:
  OrderDesk& desk_;
  InstancesUnderUpdate under_update_;
};

}  // namespace iotcloud::master
