#pragma once

#include <string>

#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/log_file.h>

namespace iotcloud::processes {

/// The account under which a gateway runs its driver hosts, if not under its own, and their rights in the state folder:
/// hosts may pass through it, have their spools (`STATE/spool`) and logs, and cannot create, remove or rename anything
/// else there. A gateway that is root gives them spools and logs; another one shares them with the account's group, of
/// which it must be a member. Thread safe.
class ChildAccount {
 public:
  /// Sets owner and permissions of the state folder. Spools of processes that ran under this process's account are
  /// given to the other one, or shared.
  /// \throws config::Error if there is no such account, if it is root, or if the folder cannot be set up (the spools
  /// belong to a third account, for example).
  ChildAccount(const std::string& user, const std::string& state_folder);

  /// Lets the account's group pass through a folder of this process, and do nothing else there. \throws config::Error
  void let_pass(const std::string& folder) const;
  /// Makes the log file, which the account may write to but not rename. \throws config::Error if it cannot.
  void make_log(const std::string& file) const;
  /// Rotates the log as LogFile::rotate_if_too_long() does, on behalf of the account, which may not rename files.
  void keep_within_bounds(const LogFile::Options& log) const;
  /// Whether that process runs under this account; true for a process that does not exist.
  bool runs(int process) const;

 private:
  /// Whether this process can give files away.
  const bool gives_;
  const Account account_;
};

}  // namespace iotcloud::processes
