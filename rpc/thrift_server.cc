#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <list>
#include <map>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/connection.h>
#include <iotcloud/rpc/logger.h>
#include <iotcloud/rpc/refusal_log.h>
#include <iotcloud/security/server_tls.h>

namespace iotcloud::rpc {

namespace {

constexpr int backlog = 128;
/// The pause after a connection could not be accepted because descriptors or memory ran out.
constexpr int pause_ms = 100;

/// \return a socket that listens. \throws Error
int listen_on(const std::string& host, int port) {
  const auto failed = [&](const std::string& why) {
    return config::Error(fmt::format(
        "cannot listen on {}:{}: {}; end the program that has the port (ss -ltnp names it), or choose another", host,
        port, why));
  };
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  addrinfo* found = nullptr;
  if (const int error = getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found); error != 0)
    throw failed(gai_strerror(error));
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> all(found, freeaddrinfo);
  int problem = EADDRNOTAVAIL;
  // Tries IPv4 first: for most clients "localhost" is 127.0.0.1.
  for (const int family : {AF_INET, AF_INET6}) {
    for (const addrinfo* one = found; one != nullptr; one = one->ai_next) {
      if (one->ai_family != family) continue;
      const int descriptor = socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
      const int on = 1;
      if (descriptor >= 0 && setsockopt(descriptor, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
          bind(descriptor, one->ai_addr, one->ai_addrlen) == 0 && listen(descriptor, backlog) == 0)
        return descriptor;
      problem = errno;
      if (descriptor >= 0) close(descriptor);
    }
  }
  throw failed(std::strerror(problem));
}

int port_of(int descriptor) {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  getsockname(descriptor, reinterpret_cast<sockaddr*>(&address), &size);
  return address.ss_family == AF_INET6 ? ntohs(reinterpret_cast<const sockaddr_in6&>(address).sin6_port)
                                       : ntohs(reinterpret_cast<const sockaddr_in&>(address).sin_port);
}

class OpenDescriptor {
 public:
  explicit OpenDescriptor(int number) : number_(number) {}
  ~OpenDescriptor() { close(number_); }
  OpenDescriptor(const OpenDescriptor&) = delete;
  OpenDescriptor& operator=(const OpenDescriptor&) = delete;
  int get() const { return number_; }

 private:
  const int number_;
};

}  // namespace

void count_refusal(const std::string& service, const std::string& reason) {
  config::process_metrics()
      .counter("iotcloud_thrift_refused_total", "Connections, messages and calls that a Thrift service refused",
               {{"service", service}, {"reason", reason}})
      .add();
}

struct ThriftServer::Impl {
  struct Client {
    Client(const ThriftServerOptions& options, const ThriftService& service,
           std::shared_ptr<const security::TlsContext> tls, int descriptor, RefusalLog& log)
        : connection(options, service, std::move(tls), descriptor, log) {}
    ThriftConnection connection;
    std::atomic<bool> done{false};
    bool evicted = false;  ///< used by the thread that accepts
    std::jthread thread;
  };

  Impl(const ThriftServerOptions& o, ThriftService s)
      : options(o),
        service(std::move(s)),
        listener(listen_on(o.host, o.port)),
        wake(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        tls(o.name, o.tls) {
    acceptor = std::jthread([this](const std::stop_token& stop) { accept_all(stop); });
  }

  ~Impl() {
    acceptor.request_stop();
    eventfd_write(wake.get(), 1);
    acceptor.join();
    for (auto& client : clients) client.connection.stop();
    clients.clear();
  }

  void reload() {
    tls.reload();
    look_now = true;
    eventfd_write(wake.get(), 1);
  }

  /// Reads TLS files that were replaced, and cuts those who may not keep their connections. Used by the thread that
  /// accepts.
  void look() {
    if (const auto problem = tls.look(); !problem.empty()) {
      thrift_logger.error("{}: it goes on with the certificate that it had: {}", options.name, problem);
    }
    const auto present = tls.context();
    for (auto& client : clients) {
      if (client.evicted) continue;
      const std::string why = client.connection.distrust(present.get());
      if (why.empty()) continue;
      client.evicted = true;
      client.connection.cut();
      count_refusal(options.name, "revoked");
      log.refused("revoked", fmt::format("{}: {} is cut off: {}", options.name, client.connection.address(), why));
    }
  }

  void accept_all(const std::stop_token& stop) {
    std::array<pollfd, 2> waiting{pollfd{wake.get(), POLLIN, 0}, pollfd{listener.get(), POLLIN, 0}};
    while (true) {
      poll(waiting.data(), waiting.size(), static_cast<int>(options.look_period.count()));
      eventfd_t ended = 0;
      eventfd_read(wake.get(), &ended);
      // checked after the read, which may have consumed the wake-up that came with the stop
      if (stop.stop_requested()) return;
      clients.remove_if([](const Client& client) { return client.done.load(); });
      if (look_now.exchange(false) || TcpStream::Clock::now() >= next_look) {
        look();
        next_look = TcpStream::Clock::now() + options.look_period;
      }
      const int descriptor = accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
      if (descriptor >= 0) {
        take(descriptor);
      } else if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
        log.refused("accept",
                    fmt::format("{}: a connection cannot be accepted: {}", options.name, std::strerror(errno)));
        count_refusal(options.name, "connections");
        poll(waiting.data(), 1, pause_ms);  // ends earlier when a client disconnects
      }
    }
  }

  /// Serves a new connection if there is room.
  void take(int descriptor) {
    if (!make_room()) {
      count_refusal(options.name, "connections");
      close(descriptor);
      log.refused("room",
                  fmt::format("{}: a connection is refused: there are {} already", options.name, clients.size()));
      return;
    }
    auto& client = clients.emplace_back(options, service, tls.context(), descriptor, log);
    try {
      client.thread = std::jthread([this, &client] {
        client.connection.serve();
        client.done = true;
        eventfd_write(wake.get(), 1);
      });
    } catch (const std::system_error& e) {
      clients.pop_back();
      count_refusal(options.name, "connections");
      log.refused("thread", fmt::format("{}: no thread for a connection: {}", options.name, e.what()));
    }
  }

  using Standings = std::map<std::string, std::vector<std::pair<Client*, ThriftConnection::Standing>>>;

  /// The connections of clients that have named themselves, by identity.
  Standings standings() {
    Standings all;
    for (auto& client : clients) {
      if (client.evicted || client.connection.is_stranger()) continue;
      auto standing = client.connection.standing();
      auto& of_one = all[standing.identity];
      of_one.emplace_back(&client, std::move(standing));
    }
    return all;
  }

  /// Cuts the connection that has been idle the longest. \return false if a call is under way on each
  static bool cut_idlest(Standings::mapped_type& of_one) {
    Standings::mapped_type::value_type* idlest = nullptr;
    for (auto& one : of_one) {
      if (one.first->evicted || one.second.answering) continue;
      if (idlest == nullptr || one.second.since < idlest->second.since) idlest = &one;
    }
    if (idlest == nullptr) return false;
    idlest->first->evicted = true;
    idlest->first->connection.cut();
    return true;
  }

  /// Cuts connections of those who have more than one may have.
  void limit_each() {
    const auto most = static_cast<std::size_t>(options.max_connections_of_one);
    if (clients.size() <= most) return;
    for (auto& [identity, of_one] : standings()) {
      if (!of_one.front().second.named) continue;
      for (auto count = of_one.size(); count > most && cut_idlest(of_one); --count) {
        count_refusal(options.name, "connections_of_one");
        log.refused("of_one", fmt::format("{}: {} has more than {} connections; the one that was idle the longest is "
                                          "closed",
                                          options.name, identity, most));
      }
    }
  }

  /// Cuts the oldest stranger if there are too many connections, or the idlest connection of the identity that has the
  /// most. \return whether there is room
  bool make_room() {
    limit_each();
    const auto most = static_cast<std::size_t>(options.max_connections);
    if (clients.size() >= 2 * most) return false;  // cut connections have not ended yet
    const auto live = std::count_if(clients.begin(), clients.end(), [](const Client& one) { return !one.evicted; });
    if (static_cast<std::size_t>(live) < most) return true;
    for (auto& client : clients) {
      if (client.evicted || !client.connection.is_stranger()) continue;
      client.evicted = true;
      client.connection.cut();
      count_refusal(options.name, "connections");
      return true;
    }
    auto all = standings();
    std::vector<Standings::mapped_type*> by_size;
    for (auto& [identity, of_one] : all) by_size.push_back(&of_one);
    std::stable_sort(by_size.begin(), by_size.end(),
                     [](const auto* one, const auto* other) { return one->size() > other->size(); });
    const bool cut = std::any_of(by_size.begin(), by_size.end(), [](auto* of_one) { return cut_idlest(*of_one); });
    if (cut) count_refusal(options.name, "connections");
    return cut;
  }

  const ThriftServerOptions options;
  const ThriftService service;
  RefusalLog log{thrift_logger};
  const OpenDescriptor listener;
  const OpenDescriptor wake;  ///< wakes the thread that accepts
  security::ServerTls tls;
  std::atomic<bool> look_now{false};
  TcpStream::Clock::time_point next_look = TcpStream::Clock::now();  ///< used by the thread that accepts
  /// In order of arrival; used by the thread that accepts, and after its end by the destructor.
  std::list<Client> clients;
  std::jthread acceptor;
};

ThriftServer::ThriftServer(const ThriftServerOptions& options, ThriftService service)
    : impl_(std::make_unique<Impl>(options, std::move(service))) {}

ThriftServer::~ThriftServer() = default;

void ThriftServer::reload() {
  impl_->reload();
}

int ThriftServer::port() const {
  return port_of(impl_->listener.get());
}

}  // namespace iotcloud::rpc
