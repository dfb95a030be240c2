#include <array>
#include <cerrno>
#include <cstring>
#include <functional>
#include <map>
#include <sstream>
#include <string>

#include <arpa/inet.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

/// A driver that tries whom its process reaches, each time that it is activated, and says what came of it in its
/// metadata: "ok", or the error's name.
///   place: "HOST PORT", which it asks for and connects to; `address` is the one that it found
///   name: of a machine, whose address it asks for, also around the host's own getaddrinfo()
///   port: of 127.0.0.1, to which it connects in ordinary ways
///   escape: a port of 127.0.0.1, to which it gets in all ways that it knows; with `port` also by a race
///   local: the path of a local socket that streams, and of one for datagrams with ".dgram"
///   families: "true": which sockets it can make
class NetworkedDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }

  void open(drivers::DriverContext& context) override { context_ = &context; }

  void activate() override {
    const auto& properties = context_->properties();
    const auto given = [&](const char* name) {
      const auto found = properties.find(name);
      return found == properties.end() ? std::string() : found->second;
    };
    std::map<std::string, std::string> facts{{"tried", "yes"}};
    if (const auto place = given("place"); !place.empty()) {
      std::istringstream words(place);
      std::string host, port;
      words >> host >> port;
      facts["place"] = by_name(host, port, facts["address"]);
    }
    if (const auto name = given("name"); !name.empty()) {
      facts["name"] = address_of(name, &getaddrinfo);
      void* const library = dlopen("libc.so.6", RTLD_NOW | RTLD_NOLOAD);
      const auto plain = reinterpret_cast<decltype(&getaddrinfo)>(dlsym(library, "getaddrinfo"));
      facts["name_by_library"] = address_of(name, plain);
    }
    if (const auto port = number(given("port")); port != 0) {
      facts["port"] = outcome([&] { return connection(port); });
      facts["port_at_once"] = outcome([&] { return at_once(port); });
    }
    if (const auto port = number(given("escape")); port != 0) escape(port, number(given("port")), facts);
    if (const auto path = given("local"); !path.empty()) {
      facts["local"] = outcome([&] { return local(path, false); });
      facts["local_by_call"] = outcome([&] { return local(path, true); });
      facts["local_datagram"] = outcome([&] { return local_datagram(path + ".dgram", false); });
      facts["local_datagram_of_a_pair"] = outcome([&] { return local_datagram(path + ".dgram", true); });
    }
    if (given("families") == "true") facts["families"] = families();
    context_->update_metadata(facts);
  }

 private:
  static constexpr long refused = -1;

  static std::uint16_t number(const std::string& text) {
    return text.empty() ? std::uint16_t{0} : static_cast<std::uint16_t>(std::stoi(text));
  }
  static std::string outcome(const std::function<long()>& attempt) {
    return attempt() >= 0 ? "ok" : strerrorname_np(errno);
  }
  /// Closes a socket and keeps errno.
  static long closed(int socket, long result) {
    const int error = errno;
    ::close(socket);
    errno = error;
    return result;
  }
  static sockaddr_in loopback(std::uint16_t port) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return to;
  }
  static const sockaddr* plain(const sockaddr_in& address) { return reinterpret_cast<const sockaddr*>(&address); }
  static int stream(int flags = 0, int protocol = 0) {
    return socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | flags, protocol);
  }

  static std::string address_of(const std::string& name, decltype(&getaddrinfo) ask) {
    addrinfo hints{};
    hints.ai_family = AF_INET;
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int problem = ask(name.c_str(), nullptr, &hints, &found); problem != 0) return gai_strerror(problem);
    std::array<char, INET_ADDRSTRLEN> text{};
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(found->ai_addr)->sin_addr, text.data(), text.size());
    freeaddrinfo(found);
    return text.data();
  }

  /// As libraries do: tries all addresses of a name.
  static std::string by_name(const std::string& host, const std::string& port, std::string& address) {
    addrinfo hints{};
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = AI_CANONNAME;
    addrinfo* found = nullptr;
    if (const int problem = getaddrinfo(host.c_str(), port.c_str(), &hints, &found); problem != 0)
      return gai_strerror(problem);
    std::string result = found->ai_canonname == nullptr ? "no canonical name" : "no address";
    for (const addrinfo* one = found; one != nullptr && result != "ok"; one = one->ai_next) {
      const int made = socket(one->ai_family, one->ai_socktype | SOCK_CLOEXEC, one->ai_protocol);
      result = outcome([&] { return made < 0 ? refused : closed(made, connect(made, one->ai_addr, one->ai_addrlen)); });
      std::array<char, NI_MAXHOST> text{};
      getnameinfo(one->ai_addr, one->ai_addrlen, text.data(), text.size(), nullptr, 0, NI_NUMERICHOST);
      address = text.data();
    }
    freeaddrinfo(found);
    return result;
  }

  static long connection(std::uint16_t port) {
    const auto to = loopback(port);
    const int made = stream();
    if (made < 0) return made;
    const long result = connect(made, plain(to), sizeof to);
    if (result == 0 && (fcntl(made, F_GETFL) & O_NONBLOCK) != 0) errno = EBADE;
    return closed(made, result);
  }
  /// Without waiting.
  static long at_once(std::uint16_t port) {
    const auto to = loopback(port);
    const int made = stream(SOCK_NONBLOCK);
    if (made < 0) return made;
    long result = connect(made, plain(to), sizeof to);
    if (result != 0 && errno == EINPROGRESS) {
      pollfd on{made, POLLOUT, 0};
      socklen_t size = sizeof errno;
      int error = 0;
      result =
          poll(&on, 1, -1) == 1 && getsockopt(made, SOL_SOCKET, SO_ERROR, &error, &size) == 0 && error == 0 ? 0 : -1;
      if (error != 0) errno = error;
    }
    return closed(made, result);
  }

  static void escape(std::uint16_t port, std::uint16_t allowed, std::map<std::string, std::string>& facts) {
    const auto to = loopback(port);
    facts["escape_by_library"] = outcome([&] { return connection(port); });
    facts["escape_by_call"] = outcome([&] {
      const int made = stream();
      return closed(made, syscall(SYS_connect, made, &to, sizeof to));
    });
    facts["escape_by_upper_bits"] = outcome([&] {
      const long made = syscall(SYS_socket, AF_INET | (1L << 32U), SOCK_STREAM | SOCK_CLOEXEC, 0);
      return closed(static_cast<int>(made), syscall(SYS_connect, made | (1L << 32U), &to, sizeof to | (1L << 32U)));
    });
    facts["escape_by_first_data"] = outcome([&] {
      const int made = stream();
      return closed(made, sendto(made, "x", 1, MSG_FASTOPEN | MSG_NOSIGNAL, plain(to), sizeof to));
    });
    facts["escape_by_first_data_of_several"] = outcome([&] { return several(to); });
    facts["escape_by_datagram"] = outcome([&] {
      const int made = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
      return made < 0 ? refused : closed(made, sendto(made, "x", 1, 0, plain(to), sizeof to));
    });
    facts["escape_by_datagram_of_ip6"] = outcome([&] {
      const int made = socket(AF_INET6, SOCK_DGRAM | SOCK_CLOEXEC, 0);
      return made < 0 ? refused : closed(made, 0);
    });
    facts["escape_by_mptcp"] = outcome([&] {
      const int made = stream(0, IPPROTO_MPTCP);
      return made < 0 ? refused : closed(made, connect(made, plain(to), sizeof to));
    });
    facts["escape_by_ip4_in_ip6"] = outcome([&] {
      sockaddr_in6 mapped{};
      mapped.sin6_family = AF_INET6;
      mapped.sin6_port = htons(port);
      inet_pton(AF_INET6, "::ffff:127.0.0.1", &mapped.sin6_addr);
      const int made = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
      return made < 0 ? refused
                      : closed(made, connect(made, reinterpret_cast<const sockaddr*>(&mapped), sizeof mapped));
    });
    facts["another_protocol"] = outcome([&] { return option(IPPROTO_TCP, TCP_ULP, "tls", 3); });
    facts["another_way"] = outcome([&] {
      constexpr std::array<unsigned char, 8> by_way_of_loopback{0x83, 7, 4, 127, 0, 0, 1, 0};
      return option(IPPROTO_IP, IP_OPTIONS, by_way_of_loopback.data(), by_way_of_loopback.size());
    });
#ifdef __x86_64__
    facts["escape_by_call_of_32_bits"] = outcome([&] { return by_call_of_32_bits(to); });
    facts["escape_by_call_of_x32"] = outcome([&] {
      constexpr long x32 = 0x40000000;
      const int made = stream();
      return closed(made, syscall(SYS_connect | x32, made, &to, sizeof to));
    });
#endif
    if (allowed == 0) return;
    facts["escape_by_disconnecting"] = outcome([&] {
      const int made = stream();
      const auto first = loopback(allowed);
      sockaddr none{};
      none.sa_family = AF_UNSPEC;
      if (connect(made, plain(first), sizeof first) != 0) return closed(made, refused);
      syscall(SYS_connect, made, &none, sizeof none);
      return closed(made, syscall(SYS_connect, made, &to, sizeof to));
    });
    race(port, allowed);
    facts["raced"] = "yes";
  }

  static long option(int level, int name, const void* value, socklen_t size) {
    const int made = stream();
    return closed(made, setsockopt(made, level, name, value, size));
  }

  static long several(sockaddr_in to) {
    char byte = 'x';
    iovec data{&byte, 1};
    mmsghdr message{};
    message.msg_hdr.msg_name = &to;
    message.msg_hdr.msg_namelen = sizeof to;
    message.msg_hdr.msg_iov = &data;
    message.msg_hdr.msg_iovlen = 1;
    const int made = stream();
    return closed(made, sendmmsg(made, &message, 1, MSG_FASTOPEN | MSG_NOSIGNAL));
  }

#ifdef __x86_64__
  static long by_call_of_32_bits(const sockaddr_in& to) {
    constexpr std::size_t page = 4096;
    void* const low = mmap(nullptr, page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_32BIT, -1, 0);
    if (low == MAP_FAILED) return refused;
    std::memcpy(low, &to, sizeof to);
    const int made = stream();
    constexpr long connect_of_32_bits = 362;
    long result = connect_of_32_bits;
    asm volatile("int $0x80"
                 : "+a"(result)
                 : "b"(static_cast<long>(made)), "c"(low), "d"(sizeof to)
                 : "memory", "r8", "r9", "r10", "r11");
    munmap(low, page);
    if (result >= 0) return closed(made, 0);
    errno = static_cast<int>(-result);
    return closed(made, refused);
  }
#endif

  /// Connects often to an address whose port changes between two: another process has the same memory, of which the
  /// thread sanitizer knows nothing.
  static void race(std::uint16_t port, std::uint16_t allowed) {
    constexpr int often = 500;
    void* const shared = mmap(nullptr, sizeof(sockaddr_in), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (shared == MAP_FAILED) return;
    auto& address = *static_cast<sockaddr_in*>(shared);
    address = loopback(allowed);
    const pid_t other = fork();
    if (other == 0) {
      volatile std::uint16_t& changing = address.sin_port;
      for (;;) {
        changing = htons(allowed);
        changing = htons(port);
      }
    }
    for (int i = 0; i < often; ++i) {
      for (const bool by_call : {false, true}) {
        const int made = stream(SOCK_NONBLOCK);
        if (by_call) {
          syscall(SYS_connect, made, &address, sizeof address);
        } else {
          connect(made, plain(address), sizeof address);
        }
        ::close(made);
      }
    }
    kill(other, SIGKILL);
    waitpid(other, nullptr, 0);
    munmap(shared, sizeof(sockaddr_in));
  }

  static sockaddr_un at(const std::string& path) {
    sockaddr_un to{};
    to.sun_family = AF_UNIX;
    std::strncpy(to.sun_path, path.c_str(), sizeof to.sun_path - 1);
    return to;
  }
  static long local(const std::string& path, bool by_call) {
    const auto to = at(path);
    const int made = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (made < 0) return made;
    return closed(made, by_call ? syscall(SYS_connect, made, &to, sizeof to)
                                : connect(made, reinterpret_cast<const sockaddr*>(&to), sizeof to));
  }
  static long local_datagram(const std::string& path, bool of_a_pair) {
    const auto to = at(path);
    std::array<int, 2> ends{-1, -1};
    if (of_a_pair) {
      if (socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0, ends.data()) != 0) return refused;
      ::close(ends[1]);
    } else {
      ends[0] = socket(AF_UNIX, SOCK_RAW | SOCK_CLOEXEC, 0);
      if (ends[0] < 0) return refused;
    }
    return closed(ends[0], sendto(ends[0], "x", 1, 0, reinterpret_cast<const sockaddr*>(&to), sizeof to));
  }

  /// The sockets that it can make, as "FAMILY.KIND.PROTOCOL", but of protocol 0 "FAMILY.KIND".
  static std::string families() {
    std::string made;
    constexpr int most_families = 64, kinds = 7, netlink_protocols = 32;
    for (int family = 0; family < most_families; ++family) {
      for (int kind = 1; kind < kinds; ++kind) {
        for (int protocol = 0; protocol < (family == AF_NETLINK ? netlink_protocols : 1); ++protocol) {
          const int one = socket(family, kind | SOCK_CLOEXEC, protocol);
          if (one < 0) continue;
          ::close(one);
          made += std::to_string(family) + "." + std::to_string(kind);
          made += (protocol == 0 ? "" : "." + std::to_string(protocol)) + " ";
        }
      }
    }
    return made;
  }

  drivers::DriverContext* context_ = nullptr;
};

}  // namespace iotcloud::gateway

IOTCLOUD_DRIVER(iotcloud::gateway::NetworkedDriver, "networked", "1.0")
