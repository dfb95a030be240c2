#pragma once

#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// Reads the pages of a topology's workers: of those on this machine itself, of others by way of a master. Used by one
/// thread.
class WorkerPages {
 public:
  /// \param master outlives this object.
  WorkerPages(MasterClient& master, discovery::TopologyName topology)
      : master_(master), topology_(std::move(topology)) {}

  /// \param target path and query. \throws Failed with the reason, which names the worker; Unreachable.
  std::string get(const discovery::WorkerRecord& worker, const std::string& target);

 private:
  MasterClient& master_;
  const discovery::TopologyName topology_;
};

}  // namespace iotcloud::master::cli
