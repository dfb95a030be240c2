#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <vector>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/udp/udp_driver.h>

namespace iotcloud::drivers::udp {

namespace {

constexpr int reads_at_once = 64;  // then other handlers of the event thread have their turn

}  // namespace

void UdpDriver::read(PropertyReader& reader) {
  listen_text_ = reader.text("listen", "");
  send_to_text_ = reader.text("send_to", "");
  multicast_ = reader.text("multicast", "");
  if (listen_text_.empty() && send_to_text_.empty()) {
    throw std::invalid_argument(
        "give one of the properties \"listen\" (ADDRESS:PORT at which datagrams come) and \"send_to\" (HOST:PORT of "
        "the "
        "device), or both");
  }
  if (!listen_text_.empty()) listen_ = stream::read_address("listen", listen_text_);
  if (!send_to_text_.empty()) peer_ = stream::split_address("send_to", send_to_text_);
  if (!multicast_.empty() && listen_text_.empty())
    throw std::invalid_argument("property \"multicast\" needs the property \"listen\" with the group's port");
}

void UdpDriver::open(DriverContext& context) {
  resolver_.emplace(context);
  retry_.emplace(context, stream::ReconnectPauses{});
  dropped_.emplace(context);
  refused_.emplace(context);
  StreamDriver::open(context);
}

void UdpDriver::close() {
  resolver_.reset();
  retry_.reset();
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
}

void UdpDriver::connect() {
  if (send_to_text_.empty()) return open_socket(listen_);
  resolver_->resolve(peer_, [this](const stream::Resolver::Answer& answer) {
    if (const auto* problem = std::get_if<std::string>(&answer)) {
      tell_away(*problem);
      return retry_->later([this] { connect(); });
    }
    // A socket sends to addresses of its own family only.
    const auto& found = std::get<std::vector<stream::Address>>(answer);
    const auto fits = [this](const stream::Address& one) {
      return listen_text_.empty() || one.family() == listen_.family();
    };
    const auto device = std::find_if(found.begin(), found.end(), fits);
    if (device == found.end()) {
      tell_away("the device has no address of the kind that " + listen_text_ + " is, IPv4 or IPv6");
      return retry_->later([this] { connect(); });
    }
    device_ = *device;
    stream::Address any;  // of the same family, and any port
    any.storage.ss_family = device_->storage.ss_family;
    any.size = device_->size;
    open_socket(listen_text_.empty() ? any : listen_);
  });
}

void UdpDriver::open_socket(const stream::Address& address) {
  socket_ = ::socket(address.family(), SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  constexpr int on = 1;
  if (socket_ >= 0) {
    setsockopt(socket_, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    if (!multicast_.empty()) setsockopt(socket_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  }
  std::string problem;
  if (socket_ < 0 || bind(socket_, address.get(), address.size) != 0) {
    problem = "cannot receive at " + address.text() + ": " + std::strerror(errno);
  } else if (!multicast_.empty()) {
    problem = join();
  }
  if (!problem.empty()) {
    if (socket_ >= 0) ::close(std::exchange(socket_, -1));
    tell_away(problem);
    return retry_->later([this] { connect(); });
  }
  const std::string own = stream::address_of(socket_).text();
  tell_connected({{"listen", own}});
  watch();
}

std::string UdpDriver::join() const {
  ip_mreq four{};
  ipv6_mreq six{};
  int status = -1;
  errno = EAFNOSUPPORT;
  if (inet_pton(AF_INET, multicast_.c_str(), &four.imr_multiaddr) == 1) {
    status = setsockopt(socket_, IPPROTO_IP, IP_ADD_MEMBERSHIP, &four, sizeof four);
  } else if (inet_pton(AF_INET6, multicast_.c_str(), &six.ipv6mr_multiaddr) == 1) {
    status = setsockopt(socket_, IPPROTO_IPV6, IPV6_JOIN_GROUP, &six, sizeof six);
  }
  return status == 0 ? "" : "cannot join the group " + multicast_ + ": " + std::strerror(errno);
}

void UdpDriver::watch() {
  readable_ = context().on_readable(socket_, [this] { receive(); });
}

void UdpDriver::receive() {
  constexpr std::size_t longest_datagram = 65'535;
  std::vector<std::byte> buffer(std::min(framing().most_bytes, longest_datagram) + 1);
  for (int i = 0; i < reads_at_once; ++i) {
    stream::Address from;
    iovec bytes{buffer.data(), buffer.size()};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(std::uint32_t))> control{};
    msghdr datagram{};
    datagram.msg_name = from.get();
    datagram.msg_namelen = from.size;
    datagram.msg_iov = &bytes;
    datagram.msg_iovlen = 1;
    datagram.msg_control = control.data();
    datagram.msg_controllen = control.size();
    const ssize_t size = recvmsg(socket_, &datagram, 0);
    if (size < 0) return;  // nothing is there, or a datagram of ours was not delivered
    if (const cmsghdr* told = CMSG_FIRSTHDR(&datagram); told && told->cmsg_type == SO_RXQ_OVFL) {
      std::uint32_t dropped = 0;
      std::memcpy(&dropped, CMSG_DATA(told), sizeof dropped);
      if (dropped != std::exchange(dropped_before_, dropped))
        dropped_->warn(std::to_string(dropped) + " datagrams came while the kernel had no room for them, and are lost");
    }
    const std::string peer = from.text();
    if ((datagram.msg_flags & MSG_TRUNC) != 0) {
      refused_->warn("a datagram from " + peer + " is longer than most_bytes");
      continue;
    }
    stream::FrameDecoder decoder(framing());
    decoder.feed(std::span(buffer).first(static_cast<std::size_t>(size)));
    try {
      while (auto frame = decoder.next()) frames_.emplace_back(std::move(*frame), peer);
      if (decoder.unfinished() || decoder.refused() > 0)
        refused_->warn("a datagram from " + peer + " is not made of whole frames (framing)");
    } catch (const stream::FramingError& e) {
      refused_->warn("a datagram from " + peer + ": " + e.what());
    }
    if (!hand_over()) return;
  }
}

bool UdpDriver::hand_over() {
  for (; !frames_.empty(); frames_.pop_front()) {
    if (publish(frames_.front().first, frames_.front().second)) continue;
    if (readable_) context().stop(*std::exchange(readable_, std::nullopt));
    return false;
  }
  return true;
}

void UdpDriver::resume() {
  if (hand_over() && !readable_ && socket_ >= 0) watch();
}

std::string UdpDriver::send(const std::string& bytes, const Message& message) {
  std::optional<stream::Address> to = device_;
  if (const std::string* peer = message.properties.find(peer_property)) {
    try {
      to = stream::read_address("peer", *peer);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
  }
  if (!to) return "nobody knows to whom: give the property send_to, or the message the property peer";
  if (socket_ < 0) return "there is no socket yet";
  const ssize_t sent = sendto(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL, to->get(), to->size);
  return sent < 0 ? "to " + to->text() + ": " + std::strerror(errno) : "";
}

}  // namespace iotcloud::drivers::udp
