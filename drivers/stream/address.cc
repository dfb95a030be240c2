#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <utility>

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <unistd.h>

#include <iotcloud/drivers/stream/address.h>

namespace iotcloud::drivers::stream {

namespace {

/// \return whether it is a number, and then in `address`.
bool read_number(const HostPort& from, Address& address) {
  auto* four = reinterpret_cast<sockaddr_in*>(&address.storage);
  auto* six = reinterpret_cast<sockaddr_in6*>(&address.storage);
  if (inet_pton(AF_INET, from.host.c_str(), &four->sin_addr) == 1) {
    four->sin_family = AF_INET;
    four->sin_port = htons(from.port);
    address.size = sizeof *four;
    return true;
  }
  if (inet_pton(AF_INET6, from.host.c_str(), &six->sin6_addr) == 1) {
    six->sin6_family = AF_INET6;
    six->sin6_port = htons(from.port);
    address.size = sizeof *six;
    return true;
  }
  return false;
}

Resolver::Answer look_up(const HostPort& name) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int problem = getaddrinfo(name.host.c_str(), std::to_string(name.port).c_str(), &hints, &found);
      problem != 0) {
    return "the name " + name.host + " has no address: " + gai_strerror(problem);
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> owned(found, &freeaddrinfo);
  std::vector<Address> addresses;
  for (const addrinfo* one = found; one != nullptr; one = one->ai_next) {
    Address& address = addresses.emplace_back();
    std::memcpy(&address.storage, one->ai_addr, one->ai_addrlen);
    address.size = one->ai_addrlen;
  }
  return addresses;
}

}  // namespace

std::string Address::text() const {
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (family() == AF_INET6) {
    const auto* six = reinterpret_cast<const sockaddr_in6*>(&storage);
    inet_ntop(AF_INET6, &six->sin6_addr, text.data(), text.size());
    return "[" + std::string(text.data()) + "]:" + std::to_string(ntohs(six->sin6_port));
  }
  const auto* four = reinterpret_cast<const sockaddr_in*>(&storage);
  inet_ntop(AF_INET, &four->sin_addr, text.data(), text.size());
  return std::string(text.data()) + ":" + std::to_string(ntohs(four->sin_port));
}

HostPort split_address(const std::string& property, const std::string& text) {
  HostPort parts;
  const auto colon = text.rfind(':');
  const char* stop = text.data() + text.size();
  if (colon != std::string::npos && colon > 0) {
    parts.host = text.substr(0, colon);
    const auto [end, status] = std::from_chars(text.data() + colon + 1, stop, parts.port);
    if (status == std::errc{} && end == stop) {
      if (parts.host.size() > 2 && parts.host.front() == '[' && parts.host.back() == ']')
        parts.host = parts.host.substr(1, parts.host.size() - 2);
      return parts;
    }
  }
  throw std::invalid_argument("property \"" + property + "\" is \"" + text +
                              "\"; it takes HOST:PORT, such as 10.0.0.7:4001 or [fe80::1]:4001");
}

Address read_address(const std::string& property, const std::string& text) {
  HostPort parts = split_address(property, text);
  if (parts.host == "localhost") parts.host = "127.0.0.1";
  Address address;
  if (read_number(parts, address)) return address;
  throw std::invalid_argument("property \"" + property + "\" is \"" + text +
                              "\"; it takes a number, not a name: 127.0.0.1:4001, 0.0.0.0:4001 or [::]:4001");
}

Address address_of(int socket) {
  Address address;
  getsockname(socket, address.get(), &address.size);
  return address;
}

Resolver::~Resolver() {
  if (wanted_) *wanted_ = false;
  if (thread_.joinable()) thread_.join();
}

void Resolver::resolve(const HostPort& name, std::function<void(const Answer&)> callback) {
  if (wanted_) *wanted_ = false;
  if (Address address; read_number(name, address)) return callback(std::vector{address});
  if (thread_.joinable()) thread_.join();
  wanted_ = std::make_shared<bool>(true);
  thread_ = std::thread([this, name, wanted = wanted_, callback = std::move(callback)] {
    context_.post([answer = look_up(name), wanted, callback] {
      if (*wanted) callback(answer);  // only the event thread reads and writes it
    });
  });
}

void prepare_connection(int socket) {
  constexpr int on = 1, idle_s = 30, interval_s = 10, probes = 3;
  setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(socket, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
  setsockopt(socket, IPPROTO_TCP, TCP_KEEPIDLE, &idle_s, sizeof idle_s);
  setsockopt(socket, IPPROTO_TCP, TCP_KEEPINTVL, &interval_s, sizeof interval_s);
  setsockopt(socket, IPPROTO_TCP, TCP_KEEPCNT, &probes, sizeof probes);
}

void Dialer::dial(const HostPort& name, std::function<void(const Answer&)> callback) {
  stop();
  whom_ = name.host + ":" + std::to_string(name.port);
  callback_ = std::move(callback);
  resolver_.resolve(name, [this](const Resolver::Answer& answer) {
    if (const auto* problem = std::get_if<std::string>(&answer)) {
      const auto call = callback_;  // a copy: the callback may dial again
      return call(*problem);
    }
    const auto& found = std::get<std::vector<Address>>(answer);
    addresses_.assign(found.rbegin(), found.rend());
    connect();
  });
}

void Dialer::connect() {
  constexpr std::chrono::seconds limit{10};
  const Address address = addresses_.back();
  addresses_.pop_back();
  socket_ = ::socket(address.family(), SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (socket_ < 0 || (::connect(socket_, address.get(), address.size) != 0 && errno != EINPROGRESS))
    return fail(std::strerror(errno));
  writable_ = context_.on_writable(socket_, [this] { connected(socket_); });
  limit_ = context_.after(limit, [this] { fail("it does not answer"); });
}

void Dialer::connected(int socket) {
  int problem = 0;
  socklen_t size = sizeof problem;
  getsockopt(socket, SOL_SOCKET, SO_ERROR, &problem, &size);
  if (problem != 0) return fail(std::strerror(problem));
  socket_ = -1;  // the callback's from now on
  stop();
  prepare_connection(socket);
  const auto callback = callback_;  // a copy: the callback may dial again
  callback(socket);
}

void Dialer::stop() {
  if (writable_) context_.stop(*std::exchange(writable_, std::nullopt));
  if (limit_) context_.stop(*std::exchange(limit_, std::nullopt));
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
}

void Dialer::fail(const std::string& why) {
  stop();
  if (!addresses_.empty()) return connect();
  const std::string problem = "cannot connect to " + whom_ + ": " + why;
  const auto callback = callback_;  // a copy: the callback may dial again
  callback(problem);
}

}  // namespace iotcloud::drivers::stream
