#pragma once

#include <string>

#include <iotcloud/gateway/host/confinement.h>
#include <iotcloud/gateway/host/control/log_file.h>

namespace iotcloud::gateway {

/// The account as which a gateway that runs as root runs its driver hosts, and what of the state folder is theirs: they
/// may pass through it, their spools (<state folder>/spool) and logs belong to them, and they can make, remove or
/// rename nothing else there. Thread safe.
class HostAccount {
 public:
  /// Makes the folder so. Spools of hosts that ran as root become the account's.
  /// \throws config::Error when there is no such account, it is root's, or the folder cannot be made so (the spools
  /// belong to a third one).
  HostAccount(const std::string& user, const std::string& state_folder);

  /// Makes the log, which the account may write to but not move. \throws config::Error.
  void make_log(const std::string& file) const;
  /// What LogFile::look() does, by who may do it.
  void keep_within_bounds(const LogFile::Options& log) const;
  /// Whether that process runs as this account; a process that is not there does.
  bool runs(int process) const;

 private:
  const Account account_;
};

}  // namespace iotcloud::gateway
