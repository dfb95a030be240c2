#pragma once

#include <string>

#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/log_file.h>

namespace iotcloud::processes {

/// The account under which a daemon runs its processes, if not under its own, and their rights in the state folder:
/// they may pass through it, use the files and folders that they are given, and cannot create, remove or rename
/// anything else there. A daemon that is root gives these away; another one shares them with the account's group, of
/// which it must be a member. Thread safe.
class ChildAccount {
 public:
  /// Sets owner and permissions of the state folder.
  /// \throws config::Error if there is no such account, if it is root, or if the folder cannot be set up.
  ChildAccount(const std::string& user, const std::string& state_folder);

  /// Lets the account's group pass through a folder of this process, and do nothing else there. \throws config::Error
  void let_pass(const std::string& folder) const;
  /// Lets the account use a folder as its own, with all that is in it; makes the folder when it is missing. What is
  /// there of processes that ran under this process's account is given to the other one, or shared.
  /// \throws config::Error if it cannot, because the folder belongs to a third account, for example
  void let_use(const std::string& folder) const;
  /// Lets the account's group read a file of this process. Does not touch one that the group may read already, so that
  /// its stamp (config::stamp_of()) stays. \throws config::Error
  void let_read(const std::string& file) const;
  /// Makes a file, such as a log, which the account may write to but not rename. \throws config::Error if it cannot.
  void make_file(const std::string& file) const;
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
