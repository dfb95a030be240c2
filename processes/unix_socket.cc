#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

namespace {

constexpr timeval send_limit{2, 0};

/// An address holds 107 characters, but a folder's path may be longer. So the address names the folder by its open
/// descriptor.
struct Address {
  Address(const std::string& folder, const std::string& name)
      : holder(open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC)) {
    const std::string path = fmt::format("/proc/self/fd/{}/{}", holder.get(), name);
    fits = holder && path.size() < sizeof(address.sun_path);
    if (fits) std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  }
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&address); }

  OwnedDescriptor holder;
  sockaddr_un address{AF_UNIX, {}};
  bool fits = false;
};

OwnedDescriptor new_socket() {
  return OwnedDescriptor(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
}

void limit_sends(const OwnedDescriptor& socket) {
  setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &send_limit, sizeof(send_limit));
}

}  // namespace

OwnedDescriptor bind_in(const std::string& folder, const std::string& name) {
  const Address address(folder, name);
  OwnedDescriptor socket = new_socket();
  if (!address.fits || !socket || bind(socket.get(), address.get(), sizeof(sockaddr_un)) != 0) {
    throw config::Error(fmt::format("cannot listen on {}/{}: {}; is the folder there and writable?", folder, name,
                                    std::strerror(errno)));
  }
  return socket;
}

void listen_on(const OwnedDescriptor& socket) {
  constexpr int waiting = 8;
  if (listen(socket.get(), waiting) == 0) return;
  throw config::Error(fmt::format("cannot listen on the socket {}: {}", socket.get(), std::strerror(errno)));
}

OwnedDescriptor listen_in(const std::string& folder, const std::string& name) {
  OwnedDescriptor socket = bind_in(folder, name);
  listen_on(socket);
  return socket;
}

OwnedDescriptor connect_in(const std::string& folder, const std::string& name) {
  const Address address(folder, name);
  OwnedDescriptor socket = new_socket();
  if (!address.fits || !socket || connect(socket.get(), address.get(), sizeof(sockaddr_un)) != 0) return {};
  limit_sends(socket);
  return socket;
}

OwnedDescriptor accept_from(const OwnedDescriptor& listener) {
  OwnedDescriptor socket(accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC));
  if (socket) limit_sends(socket);
  return socket;
}

int peer_process(const OwnedDescriptor& socket) {
  ucred credentials{};
  socklen_t size = sizeof(credentials);
  if (getsockopt(socket.get(), SOL_SOCKET, SO_PEERCRED, &credentials, &size) != 0) return 0;
  return credentials.pid;
}

bool peer_may_connect(const OwnedDescriptor& socket, const OwnedDescriptor& listener) {
  ucred credentials{};
  socklen_t size = sizeof(credentials);
  struct stat made {};
  if (getsockopt(socket.get(), SOL_SOCKET, SO_PEERCRED, &credentials, &size) != 0) return false;
  if (fstat(listener.get(), &made) != 0) return false;
  return credentials.uid == made.st_uid || credentials.uid == 0;
}

bool send_all(const OwnedDescriptor& socket, const std::string& bytes) {
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t n = send(socket.get(), bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    sent += static_cast<std::size_t>(n);
  }
  return true;
}

std::optional<std::string> receive_some(const OwnedDescriptor& socket) {
  std::array<char, 65536> buffer;
  const ssize_t n = recv(socket.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
  if (n > 0) return std::string(buffer.data(), static_cast<std::size_t>(n));
  if (n < 0 && (errno == EAGAIN || errno == EINTR)) return std::string{};
  return std::nullopt;
}

ssize_t send_with(const OwnedDescriptor& socket, std::string_view bytes, const std::vector<int>& descriptors) {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * most_passed)> control{};
  const std::size_t size = sizeof(int) * std::min(descriptors.size(), most_passed);
  iovec all{const_cast<char*>(bytes.data()), bytes.size()};
  msghdr message{};
  message.msg_iov = &all;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = CMSG_SPACE(size);
  cmsghdr* const header = CMSG_FIRSTHDR(&message);
  header->cmsg_level = SOL_SOCKET;
  header->cmsg_type = SCM_RIGHTS;
  header->cmsg_len = CMSG_LEN(size);
  std::memcpy(CMSG_DATA(header), descriptors.data(), size);
  return sendmsg(socket.get(), &message, MSG_NOSIGNAL);
}

std::optional<Passed> receive_with(const OwnedDescriptor& socket, std::size_t most) {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * most_passed)> control{};
  Passed passed;
  passed.bytes.resize(most);
  iovec all{passed.bytes.data(), passed.bytes.size()};
  msghdr message{};
  message.msg_iov = &all;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t size = recvmsg(socket.get(), &message, MSG_CMSG_CLOEXEC);
  if (size < 0) return std::nullopt;
  passed.bytes.resize(static_cast<std::size_t>(size));
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
    for (std::size_t at = 0; CMSG_LEN(at + sizeof(int)) <= header->cmsg_len; at += sizeof(int)) {
      int descriptor = -1;
      std::memcpy(&descriptor, CMSG_DATA(header) + at, sizeof(int));
      passed.descriptors.emplace_back(descriptor);
    }
  }
  return passed;
}

}  // namespace iotcloud::processes
