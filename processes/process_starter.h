#pragma once

#include <optional>
#include <string>
#include <vector>

#include <iotcloud/processes/descriptor.h>

namespace iotcloud::processes {

/// Starts processes under another account, on behalf of a daemon that has no rights to do so. systemd does it: it
/// listens on a Unix socket that only the daemon may reach, and runs serve_starter() under the other account for each
/// connection (iotcloud-host.socket with iotcloud-host@.service for driver hosts, iotcloud-worker.socket with
/// iotcloud-worker@.service for workers). Nothing of this project needs a capability for it. Thread safe.
class ProcessStarter {
 public:
  /// \param socket the path of systemd's socket. \param unit the name of the units, "iotcloud-host", for messages.
  /// \throws config::Error if this process may not connect to it.
  ProcessStarter(std::string socket, std::string unit);

  /// A process that was started.
  struct Started {
    int process = 0;
    /// Says how the process ended, see status_of(). While it is open the process's id goes to no other process.
    OwnedDescriptor connection;
  };
  /// \param arguments as for spawn(), but the program is the one at the other end. \param environment as for spawn(),
  /// but for HOME, USER and LOGNAME. \param log stdout and stderr. \param passed descriptor 3 of the process.
  /// \throws config::Error when it cannot be started, or nobody answers.
  Started start(const std::vector<std::string>& arguments, const std::vector<std::string>& environment,
                const OwnedDescriptor& log, const OwnedDescriptor& passed) const;

  /// Ends a process of the other account by force. \param pidfd the process. \return whether it was ended.
  bool kill(int pidfd) const noexcept;

 private:
  OwnedDescriptor connect() const;

  const std::string socket_, unit_;
};

/// How a process that start() started has ended, as waitpid() says it; waits 5 s at most. nullopt: the other end does
/// not say it any more.
std::optional<int> status_of(const OwnedDescriptor& connection);

/// The other end: does what one connection asks for, until its process has ended. Drops a request that is malformed.
/// \param connection the socket. \param program what start() runs. \return the exit status for this process.
int serve_starter(OwnedDescriptor connection, const std::string& program);

}  // namespace iotcloud::processes
