#pragma once

#include <map>
#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// Reads the pages of a topology's workers: of those on this machine itself; of others, and of those that did not
/// answer here once, by way of a master. Used by one thread.
class WorkerPages {
 public:
  /// \param master outlives this object.
  WorkerPages(MasterClient& master, discovery::TopologyName topology)
      : master_(master), topology_(std::move(topology)) {}

  /// \param target path and query. \throws RequestFailed with the reason, which names the worker; Unreachable.
  std::string get(const discovery::WorkerRecord& worker, const std::string& target);

 private:
  /// \param why the caller does not reach the worker itself
  std::string by_the_master(const discovery::WorkerRecord& worker, const std::string& target, const std::string& why);
  MasterClient& master_;
  const discovery::TopologyName topology_;
  std::map<std::string, std::string> unreachable_;  ///< by the name of a worker that did not answer here: why
};

}  // namespace iotcloud::master::cli
