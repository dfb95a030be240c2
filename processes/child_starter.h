#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/processes/child_account.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/log_file.h>
#include <iotcloud/processes/process_starter.h>

namespace iotcloud::processes {

/// Whom a daemon's processes have to be, and who starts them.
struct ChildUser {
  std::string name;     ///< the account; empty: the daemon's own
  std::string starter;  ///< the socket at which systemd starts processes of that account; empty: the daemon starts them
  std::string unit;     ///< the name of systemd's units for that, such as "iotcloud-host", for messages
  std::string key;      ///< of the account in the daemon's file, such as "host_user", for messages
};

/// Starts a daemon's processes, each of which listens on a Unix socket, and finds those of its earlier run: of the
/// daemon's own account; or of another one, started by systemd (ProcessStarter) or, for a daemon that is root, by the
/// daemon: such a process changes its account itself (Confinement::user). Thread safe.
class ChildStarter {
 public:
  /// Prepares the state folder for the other account, if there is one. \throws config::Error
  ChildStarter(ChildUser user, const std::string& state_folder);

  /// The other account; null: processes have this process's.
  const ChildAccount* account() const { return account_.get(); }

  /// Whether a process gets the socket on which it listens as the descriptor `passed_socket`. Such a socket belongs to
  /// this process's user, so that no other process of that account can connect to it.
  bool passes_socket() const { return starter_ != nullptr; }
  static constexpr int passed_socket = 3;

  /// Starts a process. \param arguments and `environment` as for spawn(). \param folder where the process listens.
  /// \param socket the name of its socket there. \param log_file for stdout and stderr; the other account's, if there
  /// is one (ChildAccount::make_file()). \throws config::Error when it cannot be started, for now
  ChildProcess start(std::vector<std::string> arguments, std::vector<std::string> environment,
                     const std::string& folder, const std::string& socket, const std::string& log_file) const;
  /// Ends a process that start() started if it has another account than it should. \throws config::Error if so
  void check(const ChildProcess& process) const;
  /// A process that an earlier run of the daemon started.
  ChildProcess found(int process) const { return {process, starter_}; }
  /// Why a process that an earlier run started is not to be used; empty: it has the account that it should have.
  std::string objection(int process) const;

  /// A function that keeps such a process's log within bounds; empty if the process may do that itself.
  std::function<void()> log_keeper(LogFile::Options log) const;

 private:
  const ChildUser user_;
  const std::shared_ptr<const ProcessStarter> starter_;  ///< null: this process starts processes itself
  const std::shared_ptr<const ChildAccount> account_;
};

}  // namespace iotcloud::processes
