// The system calls that a confined process may not make: those that attacks on the kernel and on other processes use,
// and those of administrators. Files, sockets, devices (ioctl), threads and programs are not restricted.
#include <array>
#include <cerrno>
#include <cstring>
#include <memory>

#include <fmt/format.h>
#include <sched.h>
#include <seccomp.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/confinement.h>

namespace iotcloud::processes {

namespace {

// clang-format off
constexpr std::array refused_calls = {
    // other processes
    "ptrace", "process_vm_readv", "process_vm_writev", "process_madvise", "kcmp", "pidfd_getfd",
    // mounts, and what of them a process sees
    "mount", "umount", "umount2", "pivot_root", "chroot", "move_mount", "open_tree", "fsopen", "fsconfig", "fsmount",
    "fspick", "mount_setattr", "unshare", "setns", "open_by_handle_at", "quotactl", "quotactl_fd",
    // loading code into the kernel
    "init_module", "finit_module", "delete_module", "create_module", "kexec_load", "kexec_file_load", "bpf",
    "perf_event_open", "userfaultfd",
    // the machine
    "reboot", "swapon", "swapoff", "acct", "sethostname", "setdomainname", "settimeofday", "clock_settime", "stime",
    "iopl", "ioperm", "vhangup", "syslog", "nfsservctl",
    // a second way to make most calls, which this filter does not see
    "io_uring_setup", "io_uring_enter", "io_uring_register",
    // keys that the kernel keeps
    "keyctl", "add_key", "request_key",
};
// clang-format on

/// Flags of clone() that make name spaces, as unshare() does.
constexpr std::array<scmp_datum_t, 7> name_spaces = {CLONE_NEWUSER, CLONE_NEWNS,  CLONE_NEWPID,   CLONE_NEWNET,
                                                     CLONE_NEWIPC,  CLONE_NEWUTS, CLONE_NEWCGROUP};

void check(int result, const std::string& what) {
  if (result < 0) throw config::Error(fmt::format("the filter for system calls: {}: {}", what, std::strerror(-result)));
}

}  // namespace

void filter_system_calls() {
  const std::unique_ptr<void, decltype(&seccomp_release)> filter(seccomp_init(SCMP_ACT_ALLOW), &seccomp_release);
  if (!filter) throw config::Error("the filter for system calls: there is no memory for it");
  // Calls of another architecture (32 bit) have other numbers, so all of them are refused.
  check(seccomp_attr_set(filter.get(), SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_ERRNO(EPERM)), "other architectures");
  check(seccomp_attr_set(filter.get(), SCMP_FLTATR_CTL_TSYNC, 1), "all threads");
  for (const char* name : refused_calls) {
    const int number = seccomp_syscall_resolve_name(name);
    if (number == __NR_SCMP_ERROR) continue;  // the library does not know this call
    check(seccomp_rule_add(filter.get(), SCMP_ACT_ERRNO(EPERM), number, 0), name);
  }
  for (const scmp_datum_t flag : name_spaces) {
    const scmp_arg_cmp has_flag{0, SCMP_CMP_MASKED_EQ, flag, flag};
    check(seccomp_rule_add_array(filter.get(), SCMP_ACT_ERRNO(EPERM), SCMP_SYS(clone), 1, &has_flag), "clone");
  }
  // clone3() has its flags in memory, which a filter cannot read. ENOSYS makes callers use clone() instead.
  check(seccomp_rule_add(filter.get(), SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(clone3), 0), "clone3");
  check(seccomp_load(filter.get()), "the kernel refuses it (it needs CONFIG_SECCOMP_FILTER)");
}

}  // namespace iotcloud::processes
