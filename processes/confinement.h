#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include <iotcloud/processes/connector.h>
#include <iotcloud/processes/landlock.h>

namespace iotcloud::processes {

/// An account of this machine.
struct Account {
  std::string name;
  uid_t user = 0;
  gid_t group = 0;
  std::string home;
};
/// \throws config::Error when there is no account of that name.
Account find_account(const std::string& name);

/// The rights that a process gives up before it runs somebody else's code. By default it gives up none.
struct Confinement {
  /// The account to change to, with its groups; empty: no change. Only root can change the account.
  std::string user;
  std::uint64_t open_files = 0;  ///< limit on open descriptors; 0: the inherited limit
  /// Limit on the processes and threads of the account, all its processes together; 0: the inherited limit. Root has
  /// no limit.
  std::uint64_t processes = 0;
  bool no_new_privileges = false;  ///< programs that it starts gain no privileges by set-user-id bits
  bool debuggable = true;          ///< false: no core dumps, and no debugger of the same user
  bool filter_calls = false;       ///< see filter_system_calls()
  /// The files that it may reach; nullopt: no restriction. Needs no_new_privileges. A kernel without Landlock restricts
  /// nothing, which the process logs.
  std::optional<FileAccess> files;
  /// The TCP ports that it may connect to; it then has no other transport of the internet, and asks for names by TCP
  /// (port 53). nullopt: no restriction. Needs no_new_privileges and filter_calls, and a kernel that can do it.
  std::optional<std::vector<std::uint16_t>> ports;
  /// The only places to which its sockets get connected, by a process of their own (start_connector()); it then has no
  /// other transport of any network, no local sockets of others, and no names of other machines. nullopt: no
  /// restriction. Needs what lacks_for_network() says.
  std::optional<Network> network;
};

/// What of a process's confinement is missing for a list of places, around which it would get: the key of a daemon's
/// file and its value. \param prefix of the keys. \return empty: nothing. \throws config::Error if this kernel cannot
/// do it.
std::string lacks_for_network(const Confinement& confinement, const std::string& prefix);

/// Applies the confinement to this process, for good. Call it while the process has one thread.
/// \throws config::Error if a step fails; the process is then partly confined and must not go on.
void confine(const Confinement& confinement);

/// System calls that no plugin needs fail with EPERM from now on, in all threads and in what they start: those that
/// look into other processes, mount, load code into the kernel, set the clock, open name spaces, restart the machine
/// (call_filter.cc has the list). \throws config::Error when the kernel has no seccomp.
void filter_system_calls();

/// Leaves this process only one way to the internet from now on, in all threads and in what they start: TCP connections
/// that begin with connect(), which restrict_connections() controls. Other kinds of sockets, data in the first packet
/// (TCP Fast Open), and what makes another transport or another way of a connection fail with EPERM.
/// \throws config::Error when the kernel has no seccomp.
void filter_transports();

/// Takes from this process, all its threads and what they start the right to connect: connect() fails with EACCES,
/// whatever the address, which a filter does not see. Sockets that need no connect() to reach somebody, and those of
/// other families than the internet's and local ones, fail with EPERM; what the kernel tells about interfaces and
/// devices (netlink) may be heard. With filter_transports() nothing is left but connections that others make: a
/// connector, or clients from outside. \throws config::Error when the kernel has no seccomp.
void filter_connections();

}  // namespace iotcloud::processes
