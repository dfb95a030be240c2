#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <optional>
#include <semaphore>
#include <set>
#include <string_view>
#include <thread>
#include <utility>
#include <variant>

#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/confinement.h>
#include <iotcloud/processes/connector.h>
#include <iotcloud/processes/connector_request.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/landlock.h>
#include <iotcloud/processes/logger.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

namespace {

constexpr std::size_t longest_answer = 8192, most_addresses = 128;
constexpr std::ptrdiff_t most_lookups = 32;
constexpr const char* ready = "+";

/// What an answer begins with; addresses as text follow, each with its end.
struct Answer {
  int error = 0;         ///< errno of connect(), or the result of getaddrinfo()
  bool refused = false;  ///< the address or name is none of the places
};

std::array<OwnedDescriptor, 2> pair_of_sockets() {
  std::array<int, 2> ends{-1, -1};
  socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data());
  return {OwnedDescriptor(ends[0]), OwnedDescriptor(ends[1])};
}

void answer_with(const OwnedDescriptor& reply, const Answer& answer, const std::string& addresses = {}) {
  std::string bytes(sizeof answer, '\0');
  std::memcpy(bytes.data(), &answer, sizeof answer);
  bytes += addresses;
  send(reply.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
}

std::vector<IpAddress> resolve(const std::string& name, bool configured) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = configured ? AI_ADDRCONFIG : 0;
  addrinfo* found = nullptr;
  std::vector<IpAddress> addresses;
  if (getaddrinfo(name.c_str(), nullptr, &hints, &found) != 0) return addresses;
  for (const addrinfo* one = found; one != nullptr && addresses.size() < most_addresses; one = one->ai_next) {
    sockaddr_storage address{};
    std::memcpy(&address, one->ai_addr, std::min<std::size_t>(one->ai_addrlen, sizeof address));
    if (const auto endpoint = endpoint_of(address, one->ai_addrlen)) addresses.push_back(endpoint->address);
  }
  freeaddrinfo(found);
  return addresses;
}

/// The process that makes the connections. What comes from the other one is input: that runs foreign code.
class Connector {
 public:
  Connector(OwnedDescriptor channel, OwnedDescriptor other, const std::vector<Place>& places)
      : channel_(std::move(channel)), other_(std::move(other)), places_(places, resolve, clock_) {}

  /// Serves until the other process has ended, or closed the channel.
  void run() {
    constexpr std::chrono::minutes refresh_period{1};
    auto refreshed = clock_.now();
    for (;;) {
      std::array<pollfd, 2> on{{{channel_.get(), POLLIN, 0}, {other_.get(), POLLIN, 0}}};
      poll(on.data(), on.size(), static_cast<int>(std::chrono::milliseconds(refresh_period).count()));
      if (on[1].revents != 0) return;
      if (clock_.now() - refreshed >= refresh_period) {
        refreshed = clock_.now();
        apart([this] { places_.refresh(); });
      }
      if (on[0].revents == 0) continue;
      auto request = receive_with(channel_, longest_connector_request);
      if (!request && errno == EINTR) continue;
      if (!request || request->bytes.empty()) return;
      if (!request->descriptors.empty()) take(*std::move(request));
    }
  }

 private:
  struct Connecting {
    OwnedDescriptor reply, socket;
    ConnectRequest to;
  };

  void take(Passed passed) {
    const auto request = decode_connector_request(passed.bytes, passed.descriptors.size());
    if (!request) return;
    OwnedDescriptor reply = std::move(passed.descriptors.front());
    if (const auto* wanted = std::get_if<FindRequest>(&*request))
      return find(std::move(reply), wanted->name, wanted->configured);
    auto asked = std::make_shared<Connecting>();
    asked->reply = std::move(reply);
    asked->socket = std::move(passed.descriptors.back());
    asked->to = std::get<ConnectRequest>(*request);
    connect(asked);
  }

  void find(OwnedDescriptor reply, const std::string& name, bool configured) {
    if (!places_.has_name(name)) {
      answer_with(reply, {EAI_FAIL, true});
      return;
    }
    apart([this, name, configured, to = std::make_shared<OwnedDescriptor>(std::move(reply))] {
      std::string addresses;
      for (const auto& address : places_.ask(name, configured)) addresses += to_text(address) + '\0';
      answer_with(*to, {addresses.empty() ? EAI_AGAIN : 0, false}, addresses);
    });
  }

  void connect(const std::shared_ptr<Connecting>& asked) {
    const auto endpoint = endpoint_of(asked->to.address, asked->to.size);
    if (!endpoint || !is_tcp(asked->socket, asked->to.address.ss_family)) {
      answer_with(asked->reply, {EACCES, true});
    } else if (places_.knows(*endpoint)) {
      answer_with(asked->reply, {connected(*asked), false});
    } else {
      apart([this, asked, to = *endpoint] {
        const bool allowed = places_.allows(to);
        answer_with(asked->reply, {allowed ? connected(*asked) : EACCES, !allowed});
      });
    }
  }

  /// Does what may wait for the network in a thread of its own.
  void apart(std::function<void()> work) {
    free_lookups_.acquire();
    std::thread([this, work = std::move(work)] {
      try {
        work();
      } catch (const std::exception&) {  // no memory: whoever asked sees that no answer comes
      }
      free_lookups_.release();
    }).detach();
  }

  static bool is_tcp(const OwnedDescriptor& socket, int family) {
    const auto option = [&](int name) {
      int value = -1;
      socklen_t size = sizeof value;
      return getsockopt(socket.get(), SOL_SOCKET, name, &value, &size) == 0 ? value : -1;
    };
    return option(SO_DOMAIN) == family && option(SO_TYPE) == SOCK_STREAM && option(SO_PROTOCOL) == IPPROTO_TCP;
  }

  /// Connects the socket, which does not block. \return 0 or errno.
  static int connected(const Connecting& asked) {
    const auto* const address = reinterpret_cast<const sockaddr*>(&asked.to.address);
    return syscall(SYS_connect, asked.socket.get(), address, asked.to.size) == 0 ? 0 : errno;
  }

  const OwnedDescriptor channel_, other_;
  const config::Clock& clock_ = config::system_clock();
  AllowedPlaces places_;
  std::counting_semaphore<> free_lookups_{most_lookups};
};

/// Closes all descriptors above stderr but these two, which get the first numbers there.
void keep_only(OwnedDescriptor& one, OwnedDescriptor& other) {
  constexpr int first = STDERR_FILENO + 1, second = first + 1, beyond = second + 1;
  const int spare = fcntl(one.get(), F_DUPFD, beyond), other_spare = fcntl(other.get(), F_DUPFD, beyond);
  if (spare < 0 || other_spare < 0) throw config::Error("no descriptor is left");
  dup2(spare, first);
  dup2(other_spare, second);
  closefrom(beyond);
  one.release();
  other.release();
  one = OwnedDescriptor(first);
  other = OwnedDescriptor(second);
}

/// What the new process does; it never returns. \param other the process that it serves
[[noreturn]] void be_connector(OwnedDescriptor channel, OwnedDescriptor other, const std::vector<Place>& places) try {
  keep_only(channel, other);
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, nullptr);  // it ends with the other one, and not before
  const OwnedDescriptor nowhere(open("/dev/null", O_WRONLY | O_CLOEXEC));
  prctl(PR_SET_NAME, "connector", 0, 0, 0);
  prctl(PR_SET_DUMPABLE, 0, 0, 0, 0);
  prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
  restrict_files({{"/"}, {}});  // it writes nothing, and is in no set of rules of the other one
  filter_system_calls();
  send(channel.get(), ready, 1, MSG_NOSIGNAL);
  // The other one moves its log on.
  for (const int log : {STDOUT_FILENO, STDERR_FILENO}) dup2(nowhere.get(), log);
  auto* const connector = new Connector(std::move(channel), std::move(other), places);  // its threads may outlast run()
  connector->run();
  _exit(0);
} catch (const std::exception& e) {
  logger.error("the process that makes connections: {}", e.what());
  _exit(1);
}

/// This process's side.
struct Client {
  OwnedDescriptor channel;
  std::string remedy;
  const Client* before = nullptr;  ///< which threads may still be using
  config::Mutex mutex;
  std::set<std::string> told IOTCLOUD_GUARDED_BY(mutex);  ///< what the log said
};
/// Never destroyed: libraries connect until the process has ended.
std::atomic<Client*> client{nullptr};

/// Says once that something was refused.
void tell_refused(Client& of, const std::string& what) {
  constexpr std::size_t most_told = 100;
  {
    const config::MutexLock lock(of.mutex);
    if (of.told.size() >= most_told || !of.told.insert(what).second) return;
  }
  logger.warn("{}, which is none of the places that it may connect to: {}", what, of.remedy);
}

/// The answer to a request; nullopt: none came, as when no descriptor is left. \param socket to be passed; -1: none.
std::optional<std::pair<Answer, std::string>> answer_to(const Client& of, const std::string& request, int socket) {
  auto [ours, theirs] = pair_of_sockets();
  if (!ours) return std::nullopt;
  std::vector<int> descriptors{theirs.get()};
  if (socket >= 0) descriptors.push_back(socket);
  if (send_with(of.channel, request, descriptors) < 0) {
    if (errno != EPIPE && errno != ECONNRESET && errno != ENOTCONN) return std::nullopt;
    logger.error("the process that makes the connections of this one is gone; this one ends, and both start again");
    std::_Exit(1);
  }
  theirs.reset();
  std::string bytes(longest_answer, '\0');
  ssize_t size = 0;
  do {
    size = recv(ours.get(), bytes.data(), bytes.size(), 0);
  } while (size < 0 && errno == EINTR);
  Answer answer;
  if (size < static_cast<ssize_t>(sizeof answer)) return std::nullopt;
  std::memcpy(&answer, bytes.data(), sizeof answer);
  return std::pair(answer, bytes.substr(sizeof answer, static_cast<std::size_t>(size) - sizeof answer));
}

/// Waits until a socket that does not block is connected, as long as connect() would. \return 0 or errno.
int wait_for_connection(int socket) {
  timeval limit{};
  socklen_t size = sizeof limit;
  getsockopt(socket, SOL_SOCKET, SO_SNDTIMEO, &limit, &size);
  const auto wait = std::chrono::seconds(limit.tv_sec) + std::chrono::microseconds(limit.tv_usec);
  const auto end = std::chrono::steady_clock::now() + wait;
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    pollfd on{socket, POLLOUT, 0};
    const int ready_now =
        poll(&on, 1, wait.count() == 0 ? -1 : static_cast<int>(std::max<std::int64_t>(left.count(), 0)));
    if (ready_now < 0 && errno == EINTR) continue;
    if (ready_now < 0) return errno;
    if (ready_now == 0) return EINPROGRESS;
    int error = 0;
    size = sizeof error;
    return getsockopt(socket, SOL_SOCKET, SO_ERROR, &error, &size) == 0 ? error : errno;
  }
}

std::string in_words(const sockaddr_storage& address, socklen_t size) {
  const auto endpoint = endpoint_of(address, size);
  if (endpoint) return fmt::format("{} port {}", to_text(endpoint->address), endpoint->port);
  return address.ss_family == AF_UNIX ? "a local socket"
                                      : fmt::format("an address of the family {}", address.ss_family);
}

/// Has the socket, which does not block, connected. \return 0 or errno.
int connect_now(Client& of, int socket, const sockaddr* address, socklen_t size) {
  ConnectRequest request;
  if (size < sizeof(sa_family_t) || size > sizeof request.address) return EINVAL;
  std::memcpy(&request.address, address, size);
  request.size = size;
  const auto answer = answer_to(of, encode(request), socket);
  if (!answer) return EAGAIN;
  if (answer->first.refused)
    tell_refused(of, fmt::format("this process was kept from connecting to {}", in_words(request.address, size)));
  return answer->first.error;
}

void append(addrinfo*& list, addrinfo* more) {
  addrinfo** end = &list;
  while (*end != nullptr) end = &(*end)->ai_next;
  *end = more;
}

/// What getaddrinfo() makes of these addresses.
int list_of(decltype(&getaddrinfo) real, std::string_view addresses, const char* service, const addrinfo* hints,
            addrinfo** found) {
  addrinfo wanted = hints != nullptr ? *hints : addrinfo{};
  wanted.ai_flags = (wanted.ai_flags & ~(AI_ADDRCONFIG | AI_CANONNAME)) | AI_NUMERICHOST;
  addrinfo* list = nullptr;
  int result = EAI_NONAME;
  while (!addresses.empty()) {
    const std::string address(addresses.substr(0, addresses.find('\0')));
    addresses.remove_prefix(address.size() + 1);
    addrinfo* one = nullptr;
    const int status = real(address.c_str(), service, &wanted, &one);
    // An address of a family that is not wanted is no failure, if there is another one.
    if (status == 0) append(list, one);
    if (list == nullptr) result = status == EAI_ADDRFAMILY ? EAI_NONAME : status;
  }
  if (list == nullptr) return result;
  *found = list;
  return 0;
}

}  // namespace

void start_connector(const Network& network) {
  auto [ours, theirs] = pair_of_sockets();
  OwnedDescriptor self(static_cast<int>(syscall(SYS_pidfd_open, getpid(), 0)));
  const auto failed = [](const char* what) {
    return config::Error(fmt::format("the process that makes connections cannot be started: {}", what));
  };
  if (!ours || !self) throw failed(std::strerror(errno));
  const pid_t between = fork();
  if (between < 0) throw failed(std::strerror(errno));
  if (between == 0) {
    // Its parent ends at once, so that it is nobody's child whom drivers may wait for.
    const pid_t connector = fork();
    if (connector != 0) _exit(connector < 0 ? errno : 0);
    ours.reset();
    be_connector(std::move(theirs), std::move(self), network.places);
  }
  theirs.reset();
  int status = 0;
  while (waitpid(between, &status, 0) < 0 && errno == EINTR) {
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) != 0) throw failed(std::strerror(WEXITSTATUS(status)));
  char answer = 0;
  if (recv(ours.get(), &answer, 1, 0) != 1) throw failed("it ended at once");
  auto fresh = std::make_unique<Client>();
  fresh->channel = std::move(ours);
  fresh->remedy = network.remedy;
  fresh->before = client;
  client = fresh.release();
}

bool has_connector() noexcept {
  return client != nullptr;
}

int connect_through(int socket, const sockaddr* address, socklen_t size) noexcept try {
  const int flags = fcntl(socket, F_GETFL);
  if (flags < 0) return -1;
  const bool waits = (flags & O_NONBLOCK) == 0;
  if (waits) fcntl(socket, F_SETFL, flags | O_NONBLOCK);  // the connector waits for nobody
  int error = connect_now(*client, socket, address, size);
  if (waits && error == EINPROGRESS) error = wait_for_connection(socket);
  if (waits) fcntl(socket, F_SETFL, flags);
  if (error == 0) return 0;
  errno = error;
  return -1;
} catch (const std::exception&) {
  errno = ENOMEM;
  return -1;
}

int find_through(decltype(&getaddrinfo) real, const char* node, const char* service, const addrinfo* hints,
                 addrinfo** found) noexcept try {
  const int flags = hints != nullptr ? hints->ai_flags : AI_ADDRCONFIG;
  if (node == nullptr || (flags & AI_NUMERICHOST) != 0) return real(node, service, hints, found);
  const std::string request = encode(FindRequest{node, (flags & AI_ADDRCONFIG) != 0});
  if (request.size() > longest_connector_request) return EAI_NONAME;
  const auto answer = answer_to(*client, request, -1);
  if (!answer) return EAI_AGAIN;
  if (answer->first.refused) {
    // Addresses, and names that need no network.
    const int status = real(node, service, hints, found);
    if (status != 0) tell_refused(*client, fmt::format("this process was kept from asking for the name {}", node));
    return status;
  }
  if (answer->first.error != 0) return answer->first.error;
  const int status = list_of(real, answer->second, service, hints, found);
  if (status == 0 && (flags & AI_CANONNAME) != 0) (*found)->ai_canonname = strdup(node);
  return status;
} catch (const std::exception&) {
  return EAI_MEMORY;
}

}  // namespace iotcloud::processes
