#pragma once

#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/error.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/processes/child_account.h>

namespace iotcloud::gateway {

/// Copies of the files by which driver hosts reach their brokers (passwords, certificates, keys, authorities, lists of
/// revocations), for hosts that are confined to files. Landlock lets a process read those files that were there when it
/// was confined, and not what replaces one of them later. Of a folder it may read whatever comes into it. So hosts read
/// these copies, and a renewed file reaches hosts that run. The copies may be read by the gateway's user and the group
/// of the hosts' user.
class BrokerFiles {
 public:
  /// Makes the folder, copies the files, and removes what else is in the folder: the copies of files that no broker
  /// names any more. A file that cannot be copied now keeps the copy that an earlier run made; the log says so.
  /// \param account the hosts'; null: this process's. It is used by renew() too. \throws config::Error that names a
  /// file which cannot be copied, and of which there is no copy
  BrokerFiles(std::string folder, const std::vector<std::string>& files, const processes::ChildAccount* account);

  const std::string& folder() const { return folder_; }
  /// What the instance needs, with the paths of the copies in place of those of the files. Thread safe.
  InstanceSpec with_copies(InstanceSpec spec) const;
  /// Copies those files again that were replaced or changed since their last copy was made. One that cannot be copied
  /// now keeps its last copy, and is tried again by each further call; the log says so once for each change. Called by
  /// one thread at a time.
  void renew();

 private:
  /// Leaves a copy alone that has these bytes already: to hosts it would look like a change. \return whether the copy
  /// is another one now. \throws config::Error
  bool copy(const std::string& file, const std::string& to) const;
  /// Warns, unless the log has a warning about this version of the file.
  void complain(const std::string& file, const config::FileStamp& stamp, const config::Error& error);

  const std::string folder_;
  const processes::ChildAccount* const account_;
  std::map<std::string, std::string> copies_;            ///< by the file's path; not changed after the constructor
  std::map<std::string, config::FileStamp> copied_;      ///< the version that was copied; none: by an earlier run
  std::map<std::string, config::FileStamp> complained_;  ///< the version that could not be copied, as the log says
};

}  // namespace iotcloud::gateway
