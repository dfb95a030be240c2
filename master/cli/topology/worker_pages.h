#pragma once

#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// Reads the pages of a topology's workers: of those on this machine itself; of others, and of those that do not answer
/// here, by way of a master. Used by one thread.
class WorkerPages {
 public:
  /// \param master outlives this object.
  WorkerPages(MasterClient& master, discovery::TopologyName topology)
      : master_(master), topology_(std::move(topology)) {}

  /// \param target path and query. \throws Failed with the reason, which names the worker; Unreachable.
  std::string get(const discovery::WorkerRecord& worker, const std::string& target);

 private:
  /// \param why the caller does not reach the worker itself
  std::string by_the_master(const discovery::WorkerRecord& worker, const std::string& target, const std::string& why);
  MasterClient& master_;
  const discovery::TopologyName topology_;
};

}  // namespace iotcloud::master::cli
