#include "iotcloud/tests/brokers/rabbitmq/frame_proxy.h"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include <arpa/inet.h>
#include <fmt/core.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/brokers/broker_url.h"

namespace iotcloud::brokers {
namespace {

constexpr std::size_t frame_head = 7;
constexpr std::size_t frame_overhead = frame_head + 1;
constexpr std::size_t greeting = 8;  // "AMQP0091", the client's first bytes
constexpr int look_every_ms = 5;     // how often it checks whether answers are still held up

sockaddr_in loopback(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

std::uint32_t number_at(const std::string& bytes, std::size_t at) {
  std::uint32_t number = 0;
  for (std::size_t i = at; i < at + 4; ++i) number = number << 8U | static_cast<unsigned char>(bytes[i]);
  return number;
}

amqp_channel_t channel_at(const std::string& frame, std::size_t at) {
  return static_cast<amqp_channel_t>(number_at(frame, at) >> 8U & 0xFFFFU);
}

bool send_all(int socket, const std::string& bytes) {
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t written = ::send(socket, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (written <= 0) return false;
    sent += static_cast<std::size_t>(written);
  }
  return true;
}

}  // namespace

struct FrameProxy::Pair {
  Pair(int of_client, int of_server) : client(of_client), server(of_server) {}
  Pair(const Pair&) = delete;
  Pair& operator=(const Pair&) = delete;
  ~Pair() {
    ::close(client);
    ::close(server);
  }
  const int client;
  const int server;
  bool greeted = false;
  bool exempt = false;       ///< made while messages were withheld
  bool client_gone = false;  ///< and the messages that it published are withheld, or have arrived late
  std::string withheld;
  std::string from_client;  ///< the bytes of an incomplete frame
  std::string from_server;
};

FrameProxy::FrameProxy(const std::string& server_url, Buffers buffers)
    : server_port_(parse_broker_url(server_url).port), listener_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  sockaddr_in address = loopback(0);
  socklen_t length = sizeof(address);
  auto* const generic = reinterpret_cast<sockaddr*>(&address);
  if (buffers == Buffers::small) {
    // A client's kernel sizes its send buffer by the largest segment, which on loopback is 64 KB.
    const int segment = 536;
    const int receiving = 4096;
    ::setsockopt(listener_, IPPROTO_TCP, TCP_MAXSEG, &segment, sizeof(segment));
    ::setsockopt(listener_, SOL_SOCKET, SO_RCVBUF, &receiving, sizeof(receiving));
  }
  if (listener_ < 0 || ::bind(listener_, generic, length) != 0 || ::listen(listener_, 16) != 0 ||
      ::getsockname(listener_, generic, &length) != 0) {
    throw std::runtime_error("cannot listen on loopback");
  }
  url_ = fmt::format("amqp://guest:guest@127.0.0.1:{}/", ntohs(address.sin_port));
  thread_ = std::thread([this] { run(); });
}

FrameProxy::~FrameProxy() {
  ending_ = true;
  thread_.join();
  ::close(listener_);
}

int FrameProxy::seen(amqp_method_number_t method) const {
  const std::lock_guard lock(mutex_);
  const auto found = seen_.find(method);
  return found == seen_.end() ? 0 : found->second;
}

void FrameProxy::run() {
  while (!ending_) {
    std::vector<pollfd> waiting{{listener_, POLLIN, 0}};
    for (const auto& pair : pairs_) {
      if (!withholding_ && !pair->withheld.empty()) send_all(pair->server, std::exchange(pair->withheld, {}));
      waiting.push_back({pair->client_gone || !taking_ ? -1 : pair->client, POLLIN, 0});
      waiting.push_back({holding_ ? -1 : pair->server, POLLIN, 0});
    }
    if (::poll(waiting.data(), waiting.size(), look_every_ms) <= 0) continue;
    for (std::size_t i = pairs_.size(); i-- > 0;) {
      const bool lives = (waiting[2 * i + 1].revents == 0 || pass_on(*pairs_[i], false)) &&
                         (waiting[2 * i + 2].revents == 0 || pass_on(*pairs_[i], true));
      if (!lives) pairs_.erase(pairs_.begin() + static_cast<std::ptrdiff_t>(i));
    }
    if (waiting[0].revents != 0) accept_one();
  }
}

void FrameProxy::accept_one() {
  const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
  if (client < 0) return;
  auto pair = std::make_unique<Pair>(client, ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const sockaddr_in address = loopback(server_port_);
  if (::connect(pair->server, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) return;
  pair->exempt = withholding_;
  ++connections_;
  pairs_.push_back(std::move(pair));
}

bool FrameProxy::pass_on(Pair& pair, bool from_server) {
  std::array<char, 65536> chunk{};
  const ssize_t size = ::recv(from_server ? pair.server : pair.client, chunk.data(), chunk.size(), 0);
  if (size <= 0) {
    pair.client_gone = !from_server && !pair.withheld.empty();
    return pair.client_gone;
  }
  if (pair.client_gone) return true;  // the client is gone
  std::string& bytes = from_server ? pair.from_server : pair.from_client;
  bytes.append(chunk.data(), static_cast<std::size_t>(size));
  std::string out;
  if (!from_server && !pair.greeted && bytes.size() >= greeting) {
    pair.greeted = true;
    out = bytes.substr(0, greeting);
    bytes.erase(0, greeting);
  }
  std::size_t at = 0;
  bool withhold = !pair.withheld.empty();
  while (pair.greeted && bytes.size() - at >= frame_overhead) {
    const std::size_t length = number_at(bytes, at + 3) + frame_overhead;
    if (bytes.size() - at < length) break;
    const bool is_method = bytes[at] == AMQP_FRAME_METHOD;
    const amqp_method_number_t method = is_method ? number_at(bytes, at + frame_head) : 0;
    if (method == AMQP_CHANNEL_OPEN_METHOD) highest_channel_ = std::max(highest_channel_.load(), channel_at(bytes, at));
    withhold = withhold || (withholding_ && !pair.exempt && method == AMQP_BASIC_PUBLISH_METHOD);
    const bool swallow = from_server && swallowing_ && method == AMQP_BASIC_ACK_METHOD;
    if (!swallow) out.append(bytes, at, length);
    if (is_method && !swallow) {
      const std::lock_guard lock(mutex_);
      ++seen_[method];
    }
    at += length;
  }
  bytes.erase(0, at);
  if (withhold && !from_server) {
    pair.withheld += out;
    return true;
  }
  return send_all(from_server ? pair.client : pair.server, out);
}

}  // namespace iotcloud::brokers
