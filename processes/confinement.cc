#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include <fmt/format.h>
#include <grp.h>
#include <pwd.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/logger.h>

namespace iotcloud::processes {

namespace {

config::Error refused(const std::string& what) {
  return config::Error(fmt::format("this process cannot {}: {}", what, std::strerror(errno)));
}

void limit(int resource, std::uint64_t most, const std::string& what) {
  const rlimit both{most, most};
  if (setrlimit(static_cast<__rlimit_resource>(resource), &both) != 0) throw refused(what);
}

void become(const Account& account) {
  if (geteuid() == account.user) return;
  if (initgroups(account.name.c_str(), account.group) != 0 ||
      setresgid(account.group, account.group, account.group) != 0 ||
      setresuid(account.user, account.user, account.user) != 0) {
    throw refused(fmt::format("become the user {} (only root may)", account.name));
  }
  if (account.user != 0 && setuid(0) == 0) {
    throw config::Error(fmt::format("this process became the user {} and could still become root", account.name));
  }
  // Libraries read these variables.
  setenv("HOME", account.home.c_str(), 1);
  setenv("USER", account.name.c_str(), 1);
  setenv("LOGNAME", account.name.c_str(), 1);
}

}  // namespace

Account find_account(const std::string& name) {
  passwd entry{};
  passwd* found = nullptr;
  std::array<char, 16384> strings;
  errno = getpwnam_r(name.c_str(), &entry, strings.data(), strings.size(), &found);
  if (found == nullptr) {
    throw config::Error(errno == 0
                            ? fmt::format("there is no user \"{}\" on this machine", name)
                            : fmt::format("the user \"{}\" cannot be looked up: {}", name, std::strerror(errno)));
  }
  return {name, entry.pw_uid, entry.pw_gid, entry.pw_dir};
}

std::string lacks_for_network(const Confinement& confinement, const std::string& prefix) {
  if (landlock_version() == 0) {
    throw config::Error(
        "this kernel has no Landlock (Linux 5.13): processes would get around a list of places by the files of others");
  }
  if (!confinement.filter_calls) return prefix + "call_filter: true";
  if (!confinement.files) return prefix + "files: {read: [], write: [/tmp]}";
  if (geteuid() == 0 && confinement.user.empty()) return prefix + "user: a user without rights";
  return "";
}

void confine(const Confinement& confinement) {
  if (confinement.network) {
    const std::string lacks = lacks_for_network(confinement, "");
    if (!lacks.empty() || !confinement.no_new_privileges)
      throw config::Error("a list of places restricts nothing here without " +
                          (lacks.empty() ? "no_new_privileges" : lacks));
  }
  // First the steps that need root; the filter last, so that it cannot affect them.
  if (confinement.open_files > 0) {
    limit(RLIMIT_NOFILE, confinement.open_files,
          fmt::format("have {} files open (more than the system allows?)", confinement.open_files));
  }
  if (confinement.processes > 0) {
    limit(RLIMIT_NPROC, confinement.processes,
          fmt::format("have {} processes (more than the system allows?)", confinement.processes));
  }
  if (!confinement.debuggable) limit(RLIMIT_CORE, 0, "do without core dumps");
  if (!confinement.user.empty()) become(find_account(confinement.user));
  if (confinement.no_new_privileges && prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) throw refused("give up privileges");
  // A change of user also clears this flag, so it is set again for a process that may be debugged.
  if (prctl(PR_SET_DUMPABLE, confinement.debuggable ? 1 : 0, 0, 0, 0) != 0) throw refused("be kept from debuggers");
  // Before the rules that hold for this process and not for the one that connects for it.
  if (confinement.network) start_connector(*confinement.network);
  if (confinement.files && !restrict_files(*confinement.files)) {
    logger.warn("this kernel has no Landlock, so this process may reach all files of its user");
  }
  if (confinement.ports) {
    restrict_connections(*confinement.ports);
    setenv("RES_OPTIONS", "use-vc", 1);  // the C library asks for names by TCP
  }
  if (confinement.ports || confinement.network) filter_transports();
  if (confinement.network) filter_connections();
  if (confinement.filter_calls) filter_system_calls();
}

}  // namespace iotcloud::processes
