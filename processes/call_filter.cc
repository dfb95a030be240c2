// The system calls that a confined process may not make: those that attacks on the kernel and on other processes use,
// and those of administrators. Files, sockets, devices (ioctl), threads and programs are not restricted.
#include <array>
#include <cerrno>
#include <cstring>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <linux/netlink.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sched.h>
#include <seccomp.h>
#include <sys/socket.h>

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

using Filter = std::unique_ptr<void, decltype(&seccomp_release)>;

/// A filter that lets everything pass.
Filter new_filter() {
  Filter filter(seccomp_init(SCMP_ACT_ALLOW), &seccomp_release);
  if (!filter) throw config::Error("the filter for system calls: there is no memory for it");
  // Calls of another architecture (32 bit) have other numbers, so all of them are refused.
  check(seccomp_attr_set(filter.get(), SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_ERRNO(EPERM)), "other architectures");
  check(seccomp_attr_set(filter.get(), SCMP_FLTATR_CTL_TSYNC, 1), "all threads");
  return filter;
}

void apply(const Filter& filter) {
  check(seccomp_load(filter.get()), "the kernel refuses it (it needs CONFIG_SECCOMP_FILTER)");
}

/// Refuses a call with such arguments.
void refuse(const Filter& filter, int call, const std::vector<scmp_arg_cmp>& arguments, const char* what) {
  check(seccomp_rule_add_array(filter.get(), SCMP_ACT_ERRNO(EPERM), call, static_cast<unsigned>(arguments.size()),
                               arguments.data()),
        what);
}

/// The kernel takes 32 bits of an argument that is an int; a caller may set the others to anything.
scmp_arg_cmp is_int(unsigned argument, int value) {
  return {argument, SCMP_CMP_MASKED_EQ, 0xffffffffU, static_cast<scmp_datum_t>(value)};
}

/// The kinds of sockets, in an argument that has flags, too.
scmp_arg_cmp is_kind(int kind) {
  constexpr scmp_datum_t kind_of_socket = 0xf;
  return {1, SCMP_CMP_MASKED_EQ, kind_of_socket, static_cast<scmp_datum_t>(kind)};
}

/// Refuses a call for all values of an argument that is an int but some, which are below 32. \param also what else of
/// the call there must be
void refuse_others(const Filter& filter, int call, unsigned argument, const std::set<int>& but,
                   std::vector<scmp_arg_cmp> also, const char* what) {
  constexpr unsigned low_bits = 5, bits = 32;
  also.push_back({});
  for (unsigned bit = low_bits; bit < bits; ++bit) {
    const scmp_datum_t is_set = scmp_datum_t{1} << bit;
    also.back() = {argument, SCMP_CMP_MASKED_EQ, is_set, is_set};
    refuse(filter, call, also, what);
  }
  for (int value = 0; value < 1 << low_bits; ++value) {
    also.back() = is_int(argument, value);
    if (!but.contains(value)) refuse(filter, call, also, what);
  }
}

}  // namespace

void filter_transports() {
  const Filter filter = new_filter();
  constexpr scmp_datum_t data_before_connection = MSG_FASTOPEN;
  for (const int family : {AF_INET, AF_INET6}) {
    for (const int kind : {SOCK_DGRAM, SOCK_RAW, SOCK_RDM, SOCK_SEQPACKET, SOCK_DCCP, SOCK_PACKET}) {
      refuse(filter, SCMP_SYS(socket), {is_int(0, family), is_kind(kind)}, "datagrams");
    }
    // Streams of others than TCP: MPTCP and SCTP among them, on which Landlock has no say.
    refuse(filter, SCMP_SYS(socket), {is_int(0, family), {2, SCMP_CMP_GT, IPPROTO_TCP, 0}}, "other protocols");
  }
  for (const int family : {AF_SMC, AF_TIPC, AF_RDS, AF_VSOCK, AF_KCM, AF_XDP, AF_PACKET}) {
    refuse(filter, SCMP_SYS(socket), {is_int(0, family)}, "other families");
  }
  const auto sends_first = [](unsigned argument) {
    return scmp_arg_cmp{argument, SCMP_CMP_MASKED_EQ, data_before_connection, data_before_connection};
  };
  refuse(filter, SCMP_SYS(sendto), {sends_first(3)}, "sendto");
  refuse(filter, SCMP_SYS(sendmsg), {sends_first(2)}, "sendmsg");
  refuse(filter, SCMP_SYS(sendmmsg), {sends_first(3)}, "sendmmsg");
  // A socket of TCP that becomes one of another protocol, and a packet that goes by way of another machine.
  for (const auto& [level, option] :
       {std::pair(IPPROTO_TCP, TCP_ULP), std::pair(IPPROTO_IP, IP_OPTIONS), std::pair(IPPROTO_IPV6, IPV6_RTHDR),
        std::pair(IPPROTO_IPV6, IPV6_2292RTHDR), std::pair(IPPROTO_IPV6, IPV6_2292PKTOPTIONS)}) {
    refuse(filter, SCMP_SYS(setsockopt), {is_int(1, level), is_int(2, option)}, "options of sockets");
  }
  apply(filter);
}

void filter_connections() {
  const Filter filter = new_filter();
  check(seccomp_rule_add(filter.get(), SCMP_ACT_ERRNO(EACCES), SCMP_SYS(connect), 0), "connect");
  refuse_others(filter, SCMP_SYS(socket), 0, {AF_UNIX, AF_INET, AF_INET6, AF_NETLINK}, {}, "families");
  refuse_others(filter, SCMP_SYS(socket), 2, {NETLINK_ROUTE, NETLINK_KOBJECT_UEVENT}, {is_int(0, AF_NETLINK)},
                "netlink");
  // A local datagram names its receiver itself. SOCK_RAW is another word for it.
  for (const int call : {SCMP_SYS(socket), SCMP_SYS(socketpair)}) {
    for (const int kind : {SOCK_DGRAM, SOCK_RAW})
      refuse(filter, call, {is_int(0, AF_UNIX), is_kind(kind)}, "local datagrams");
  }
  apply(filter);
}

void filter_system_calls() {
  const Filter filter = new_filter();
  for (const char* name : refused_calls) {
    const int number = seccomp_syscall_resolve_name(name);
    if (number == __NR_SCMP_ERROR) continue;  // the library does not know this call
    check(seccomp_rule_add(filter.get(), SCMP_ACT_ERRNO(EPERM), number, 0), name);
  }
  for (const scmp_datum_t flag : name_spaces) {
    refuse(filter, SCMP_SYS(clone), {{0, SCMP_CMP_MASKED_EQ, flag, flag}}, "clone");
  }
  // clone3() has its flags in memory, which a filter cannot read. ENOSYS makes callers use clone() instead.
  check(seccomp_rule_add(filter.get(), SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(clone3), 0), "clone3");
  apply(filter);
}

}  // namespace iotcloud::processes
