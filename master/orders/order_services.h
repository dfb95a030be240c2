#pragma once

#include <utility>

#include <iotcloud/master/orders/adoption.h>
#include <iotcloud/master/orders/backups.h>
#include <iotcloud/master/orders/deployments.h>
#include <iotcloud/master/orders/draining.h>
#include <iotcloud/master/orders/forgetting.h>
#include <iotcloud/master/orders/instance_changes.h>
#include <iotcloud/master/orders/submissions.h>
#include <iotcloud/master/orders/updates.h>

namespace iotcloud::master {

/// The services that take orders to driver instances, and those that submit topologies.
struct OrderServices {
  OrderServices(discovery::Registry& registry, MasterOptions options) : desk(registry, std::move(options)) {}

  OrderDesk desk;
  Deployments deployments{desk};
  InstanceChanges changes{desk};
  Draining draining{desk};
  Adoptions adoptions{desk};
  Forgetting forgetting{desk};
  Backups backups{desk};
  Updates updates{desk};
  Submissions submissions{desk};
};

}  // namespace iotcloud::master
