#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include <zookeeper/zookeeper.h>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/zookeeper/connection.h>

namespace iotcloud::discovery::zookeeper {

/// Tells the server who this process is, if the settings say so: to be called at the first event of a connection,
/// before any other call of the session. When the library connects again, it tells it by itself. It must not be told
/// right after zookeeper_init2, while the library's thread connects: now and then the server then never hears it (seen
/// with 3.8.0 and a server behind a TLS tunnel), and refuses this process everything. A failure is logged.
void identify(zhandle_t* handle, const Settings& settings);

/// The rights on a node that a user creates, as the C client wants them. With an identity the node belongs to its
/// creator or to the users that RegistryAccess names, and the settings say whether others may read it. Without an
/// identity everybody may use it. Immutable.
class NodeRights {
 public:
  /// \param creator whose node it is
  NodeRights(const Settings& settings, const std::string& path, const std::string& creator);
  NodeRights(const NodeRights&) = delete;
  NodeRights& operator=(const NodeRights&) = delete;

  /// Valid as long as this object.
  const ACL_vector* get() const { return rights_.empty() ? &ZOO_OPEN_ACL_UNSAFE : &list_; }
  /// Whether a node has just these rights.
  bool are(const ACL_vector& of_node) const;

 private:
  std::vector<RegistryAccess::Grant> grants_;  ///< owns the names in rights_
  std::vector<ACL> rights_;
  ACL_vector list_{};
};

/// See discovery::renew_rights().
RenewedRights renew_rights(const Settings& settings, const Paths& paths, std::chrono::milliseconds limit,
                           const std::function<void(std::size_t nodes)>& progress, ServersNodes servers);

}  // namespace iotcloud::discovery::zookeeper
