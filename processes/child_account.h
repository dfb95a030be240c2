#pragma once

#include <string>

#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/log_file.h>

namespace iotcloud::processes {

/// The account under which a gateway that runs as root runs its driver hosts, and their rights in the state folder:
/// hosts may pass through it, own their spools (`STATE/spool`) and logs, and cannot create, remove or rename anything
/// else there. Thread safe.
class ChildAccount {
 public:
  /// Sets owner and permissions of the state folder. Spools of processes that ran as root are given to the account.
  /// \throws config::Error if there is no such account, if it is root, or if the folder cannot be set up (the spools
  /// belong to a third account, for example).
  ChildAccount(const std::string& user, const std::string& state_folder);

  /// Makes the log file, which the account may write to but not rename. \throws config::Error if it cannot.
  void make_log(const std::string& file) const;
  /// Rotates the log as LogFile::rotate_if_too_long() does, on behalf of the account, which may not rename files.
  void keep_within_bounds(const LogFile::Options& log) const;
  /// Whether that process runs under this account; true for a process that does not exist.
  bool runs(int process) const;

 private:
  const Account account_;
};

}  // namespace iotcloud::processes
