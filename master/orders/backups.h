#pragma once

#include <iotcloud/master/orders/backup_file.h>
#include <iotcloud/master/orders/order_desk.h>

namespace iotcloud::master {

/// Copies what is ordered out of the registry, and writes such a copy into it again. Thread safe.
class Backups {
 public:
  explicit Backups(OrderDesk& desk) : desk_(desk) {}
  /// A topology that is being killed has no order in it. \throws discovery::RegistryError.
  Backup make() const;
  /// An outcome for each order: `done` when it stands in the registry, with the reason when its gateway does not follow
  /// it now; `failed` when another one stands there, unless the request says `replace`. An order of a topology has the
  /// instance `topologies/NAME`. What the registry has and the backup does not is left alone. Does not throw.
  OrderResult import(const ImportRequest& request);

 private:
  OrderResult import_all(const ImportRequest& request);
  void mark_draining(const discovery::GatewayId& gateway, const discovery::Lead& lead);
  ReasonedOutcome place(const discovery::GatewayId& gateway, discovery::OrderRecord order, bool replace,
                        const discovery::Lead& lead);
  ReasonedOutcome place(const TopologyBackup& topology, bool replace, const discovery::Lead& lead);
  ReasonedOutcome place(discovery::Submission submission, bool replace, const discovery::Lead& lead);

  OrderDesk& desk_;
};

}  // namespace iotcloud::master
