#pragma once

#include <cstdint>
#include <string>

#include <sys/types.h>

namespace iotcloud::gateway {

/// An account of this machine.
struct Account {
  std::string name;
  uid_t user = 0;
  gid_t group = 0;
  std::string home;
};
/// \throws config::Error when there is no account of that name.
Account find_account(const std::string& name);

/// What a driver host gives up before it loads its plugin. As it stands: nothing.
struct Confinement {
  /// The account to become, with its groups; empty: it stays who it is. Only root can become somebody else.
  std::string user;
  std::uint64_t open_files = 0;    ///< descriptors that it may have open; 0: as many as who starts it
  bool no_new_privileges = false;  ///< programs that it starts gain nothing by set-user-id bits
  bool debuggable = true;          ///< without: no core dumps, and no debugger of the same user
  bool filter_calls = false;       ///< see filter_system_calls()
};

/// Gives it up, for good. Call it while the process has one thread.
/// \throws config::Error when something cannot be given up; the process is half confined then, and must not go on.
void confine(const Confinement& confinement);

/// System calls that no driver needs fail with EPERM from now on, in all threads and in what they start: those that
/// look into other processes, mount, load code into the kernel, set the clock, open name spaces, restart the machine
/// (call_filter.cc has the list). \throws config::Error when the kernel has no seccomp.
void filter_system_calls();

}  // namespace iotcloud::gateway
