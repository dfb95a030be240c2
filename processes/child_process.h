#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/process_starter.h>

namespace iotcloud::processes {

/// Variables of this process's environment as "NAME=value": those that every program may have, such as PATH and LANG,
/// and the named ones. All others, in which a daemon has its passwords, are left out.
std::vector<std::string> environment_of(const std::vector<std::string>& more);

/// Starts a program in a session of its own, with no signal blocked or ignored and without this process's descriptors,
/// so that it survives this process. Its stdin is /dev/null; stdout and stderr are appended to a file.
/// \param arguments the program's path first. \param log_file for stdout and stderr; made when it is missing.
/// \param environment all variables that it gets, as "NAME=value". \return the process's id. \throws config::Error when
/// it cannot be started.
int spawn(std::vector<std::string> arguments, const std::string& log_file,
          std::vector<std::string> environment = environment_of({}));
/// The same with stdout and stderr to an open file, and with one descriptor of this process, as number 3.
int spawn(std::vector<std::string> arguments, const OwnedDescriptor& log, const OwnedDescriptor& passed,
          std::vector<std::string> environment);

/// The path of this process's program.
std::string own_program();

/// The path of the program of that name in the folder of this process's own program.
std::string program_beside(const std::string& name);

/// Whether a process was started with this argument, such as a name that only one process was given. False if there is
/// no such process; nullopt if its command line cannot be read, as when no descriptor is left or /proc hides others'
/// processes. A process id may have gone to another process: open a ChildProcess first, and it is the one asked about.
std::optional<bool> has_argument(int process, const std::string& argument);

/// A handle on a process that spawn() started, in this run of the program or in an earlier one. Its destructor does not
/// end the process. Not thread safe.
class ChildProcess {
 public:
  /// \param process its id. \param own whether it is a child of this process, so that its exit status is available.
  ChildProcess(int process, bool own);
  /// A process of another account, which `starter` started: in this run (the first of these constructors) or in an
  /// earlier one (the second).
  ChildProcess(ProcessStarter::Started started, std::shared_ptr<const ProcessStarter> starter);
  ChildProcess(int process, std::shared_ptr<const ProcessStarter> starter);

  int id() const { return process_; }
  /// A descriptor that is readable once the process has ended; -1: there was no such process.
  int ended() const { return descriptor_.get(); }
  /// Waits for the process to end. \return false if `limit` passed first.
  bool wait(std::chrono::milliseconds limit) const;
  /// Ends the process by force; does nothing if it has ended.
  void kill() const noexcept;
  /// How the process ended, for people: "crashed (signal 11, Segmentation fault)", "exited with status 1"; "died" if
  /// that is not known. Call it once, after the end.
  std::string how_it_ended() const;

 private:
  /// How it ended as waitpid() says it; nullopt: not known.
  std::optional<int> status() const;

  int process_;
  bool own_;
  OwnedDescriptor descriptor_;
  std::shared_ptr<const ProcessStarter> starter_;  ///< null: this process has the right to end the other one
  OwnedDescriptor starters_connection_;
};

}  // namespace iotcloud::processes
