#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iostream>
#include <string>
#include <thread>
#include <tuple>
#include <utility>
#include <vector>

#include <arpa/inet.h>
#include <fcntl.h>
#include <grp.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

using namespace std::chrono_literals;

/// A driver that tries what its process may do, and says what came of it in its metadata: "ok", or the error's name.
///   forbidden_file: a path at which it tries to make a file
///   secret_file: a path that it tries to read
///   secret_variable: a variable of the environment that it looks for
///   victim: the id of a process that it tries to signal, to debug, and to read the memory and environment of
///   near, far: addresses to which it sends a datagram
///   port, other_port: of 127.0.0.1, to which it connects
///   name: of a machine, whose IPv4 address it asks for
///   local_service: the path of a socket at which it asks a service of its machine for an address
///   children: how many processes it tries to start
///   chatter: "true": it writes 16 KiB to stdout every 2 ms
class ConfinedDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }

  void open(drivers::DriverContext& context) override {
    const auto& properties = context.properties();
    if (properties.contains("chatter")) {
      context.every(2ms, [] { std::cout << std::string(16383, '.') << std::endl; });
    }
    std::map<std::string, std::string> facts = {
        {"user", std::to_string(geteuid())},
        {"group", std::to_string(getegid())},
        {"groups_of_root", has_group(0) ? "yes" : "no"},
        {"root_again", outcome(setuid(0))},
        {"open_files", limit(RLIMIT_NOFILE)},
        {"core", limit(RLIMIT_CORE)},
        {"no_new_privileges", std::to_string(prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0))},
        {"dumpable", std::to_string(prctl(PR_GET_DUMPABLE, 0, 0, 0, 0))},
        {"unshare", outcome(unshare(0))},
        {"name_spaces", name_spaces()},
        {"clone3", outcome(syscall(SYS_clone3, nullptr, 0))},
        {"ptrace", outcome(ptrace(PTRACE_PEEKDATA, getpid(), nullptr, nullptr))},
        {"process_vm_readv", outcome(read_own_memory())},
        {"thread", outcome(thread())},
        {"program", outcome(program())},
        {"io_uring", outcome(io_uring())},
        {"processes", limit(RLIMIT_NPROC)},
        {"signal_to_parent", outcome(kill(getppid(), 0))},
    };
    if (const auto file = properties.find("secret_file"); file != properties.end()) {
      facts["secret_file"] = outcome(::open(file->second.c_str(), O_RDONLY | O_CLOEXEC));
    }
    if (const auto victim = properties.find("victim"); victim != properties.end()) {
      const pid_t process = std::stoi(victim->second);
      const std::string folder = "/proc/" + victim->second;
      facts["signal_to_victim"] = outcome(kill(process, 0));
      facts["ptrace_of_victim"] = outcome(ptrace(PTRACE_SEIZE, process, nullptr, nullptr));
      facts["memory_of_victim"] = outcome(::open((folder + "/mem").c_str(), O_RDONLY | O_CLOEXEC));
      facts["environment_of_victim"] = outcome(::open((folder + "/environ").c_str(), O_RDONLY | O_CLOEXEC));
    }
    for (const char* place : {"near", "far"}) {
      if (const auto address = properties.find(place); address != properties.end()) {
        facts[place] = outcome(datagram(address->second));
      }
    }
    for (const std::string place : {"port", "other_port"}) {
      if (const auto port = properties.find(place); port != properties.end()) {
        facts[place] = outcome(connection(port->second, 0));
        facts[place + "_by_mptcp"] = outcome(connection(port->second, IPPROTO_MPTCP));
        facts[place + "_by_first_data"] = outcome(connection(port->second, 0, true));
      }
    }
    if (const auto name = properties.find("name"); name != properties.end()) {
      facts["name"] = address_of(name->second);
    }
    if (const auto service = properties.find("local_service"); service != properties.end()) {
      facts["local_service"] = answer_of(service->second);
    }
    if (const auto count = properties.find("children"); count != properties.end()) {
      std::tie(facts["children"], facts["next_child"]) = start_children(std::stoi(count->second));
    }
    if (const auto name = properties.find("secret_variable"); name != properties.end()) {
      const char* const value = getenv(name->second.c_str());
      facts["secret_variable"] = value == nullptr ? "none" : value;
    }
    if (const auto file = properties.find("forbidden_file"); file != properties.end()) {
      facts["forbidden_file"] = outcome(::open(file->second.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600));
    }
    context.update_metadata(facts);
  }

 private:
  static std::string outcome(long result) { return result >= 0 ? "ok" : strerrorname_np(errno); }

  static bool has_group(gid_t wanted) {
    std::array<gid_t, 1024> groups{};
    const int count = getgroups(static_cast<int>(groups.size()), groups.data());
    for (int i = 0; i < count; ++i) {
      if (groups.at(static_cast<std::size_t>(i)) == wanted) return true;
    }
    return getgid() == wanted;
  }

  static std::string limit(__rlimit_resource resource) {
    rlimit now{};
    getrlimit(resource, &now);
    return std::to_string(now.rlim_max);
  }

  static long read_own_memory() {
    char from = 'x', to = ' ';
    const iovec local{&to, 1}, remote{&from, 1};
    return process_vm_readv(getpid(), &local, 1, &remote, 1, 0);
  }

  static long thread() {
    int result = -1;
    std::thread([&] { result = 0; }).join();
    return result;
  }

  /// Opens a ring whose parameters are missing: EFAULT, if the call is not refused before.
  static long io_uring() { return syscall(SYS_io_uring_setup, 1, nullptr); }

  /// The kinds of name spaces that a child of it may have, by clone().
  static std::string name_spaces() {
    std::string made;
    constexpr std::pair<const char*, long> kinds[] = {
        {"user", CLONE_NEWUSER}, {"mount", CLONE_NEWNS}, {"pid", CLONE_NEWPID},      {"net", CLONE_NEWNET},
        {"ipc", CLONE_NEWIPC},   {"uts", CLONE_NEWUTS},  {"cgroup", CLONE_NEWCGROUP}};
    for (const auto& [name, flag] : kinds) {
      const long child = syscall(SYS_clone, flag | SIGCHLD, 0, 0, 0, 0);
      if (child == 0) _exit(0);
      if (child < 0) continue;
      waitpid(static_cast<pid_t>(child), nullptr, 0);
      made += std::string(made.empty() ? "" : " ") + name;
    }
    return made;
  }

  /// Starts processes that wait, until the kernel gives no more, and ends them. \return how many there were, and what
  /// came of the next one
  static std::pair<std::string, std::string> start_children(int most) {
    std::vector<pid_t> children;
    std::string next = "ok";
    while (static_cast<int>(children.size()) < most) {
      const pid_t child = fork();
      if (child == 0) {
        pause();
        _exit(0);
      }
      next = outcome(child);
      if (child < 0) break;
      children.push_back(child);
    }
    for (const pid_t child : children) kill(child, SIGKILL);
    for (const pid_t child : children) waitpid(child, nullptr, 0);
    return {std::to_string(children.size()), next};
  }

  static std::string address_of(const std::string& name) {
    addrinfo hints{};
    hints.ai_family = AF_INET;
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int problem = getaddrinfo(name.c_str(), nullptr, &hints, &found); problem != 0)
      return gai_strerror(problem);
    std::array<char, INET_ADDRSTRLEN> text{};
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(found->ai_addr)->sin_addr, text.data(), text.size());
    freeaddrinfo(found);
    return text.data();
  }

  /// What a service says to a question, or why it cannot be asked.
  static std::string answer_of(const std::string& path) {
    sockaddr_un at{};
    at.sun_family = AF_UNIX;
    path.copy(at.sun_path, sizeof(at.sun_path) - 1);
    const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (socket < 0) return outcome(socket);
    const long connected = ::connect(socket, reinterpret_cast<const sockaddr*>(&at), sizeof at);
    std::string answer = outcome(connected);
    if (connected == 0) {
      std::array<char, 64> text{};
      const auto size = recv(socket, text.data(), text.size(), 0);
      answer.assign(text.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
    }
    ::close(socket);
    return answer;
  }

  static long datagram(const std::string& address) {
    constexpr std::uint16_t discard = 9;
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(discard);
    if (inet_pton(AF_INET, address.c_str(), &to.sin_addr) == 1) return datagram(to);
    sockaddr_in6 to6{};
    to6.sin6_family = AF_INET6;
    to6.sin6_port = htons(discard);
    inet_pton(AF_INET6, address.c_str(), &to6.sin6_addr);
    return datagram(to6);
  }

  template <typename Address>
  static long datagram(const Address& to) {
    const auto* const address = reinterpret_cast<const sockaddr*>(&to);
    const int socket = ::socket(address->sa_family, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (socket < 0) return socket;
    const long sent = sendto(socket, "", 1, 0, address, sizeof(to));
    const int error = errno;
    ::close(socket);
    errno = error;
    return sent;
  }

  /// \param by_data with data of the first packet, without connect()
  static long connection(const std::string& port, int protocol, bool by_data = false) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(port)));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    // A family of which the kernel ignores the upper half.
    const long socket = syscall(SYS_socket, AF_INET | (1L << 32U), SOCK_STREAM | SOCK_CLOEXEC, protocol);
    if (socket < 0) return socket;
    const auto* const address = reinterpret_cast<const sockaddr*>(&to);
    const int descriptor = static_cast<int>(socket);
    const long result = by_data ? sendto(descriptor, "x", 1, MSG_FASTOPEN | MSG_NOSIGNAL, address, sizeof(to))
                                : ::connect(descriptor, address, sizeof(to));
    const int error = errno;
    ::close(descriptor);
    errno = error;
    return result;
  }

  static long program() {
    std::string name = "/bin/true";
    std::array<char*, 2> arguments = {name.data(), nullptr};
    pid_t child = 0;
    errno = posix_spawn(&child, name.c_str(), nullptr, nullptr, arguments.data(), environ);
    if (errno != 0) return -1;
    int status = -1;
    return waitpid(child, &status, 0) == child && status == 0 ? 0 : -1;
  }
};

}  // namespace iotcloud::gateway

IOTCLOUD_DRIVER(iotcloud::gateway::ConfinedDriver, "confined", "1.0")
