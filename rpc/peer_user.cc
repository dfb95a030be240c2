#include <algorithm>
#include <array>
#include <cstring>
#include <fstream>
#include <memory>
#include <sstream>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <linux/inet_diag.h>
#include <linux/netlink.h>
#include <linux/sock_diag.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <pwd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/rpc/peer_user.h>

namespace iotcloud::rpc {

namespace {

/// The two ends of a connection, the other end's first.
struct Ends {
  int family = AF_UNSPEC;
  std::array<std::uint32_t, 4> from{}, to{};  ///< in network order; IPv4 has the first word only
  std::uint16_t from_port = 0, to_port = 0;   ///< in network order
};

bool read_end(const sockaddr_storage& end, Ends& ends, std::array<std::uint32_t, 4>& address, std::uint16_t& port) {
  ends.family = end.ss_family;
  if (end.ss_family == AF_INET) {
    const auto& four = reinterpret_cast<const sockaddr_in&>(end);
    address[0] = four.sin_addr.s_addr;
    port = four.sin_port;
    return (ntohl(four.sin_addr.s_addr) >> 24U) == 127;
  }
  if (end.ss_family != AF_INET6) return false;
  const auto& six = reinterpret_cast<const sockaddr_in6&>(end);
  std::memcpy(address.data(), &six.sin6_addr, sizeof six.sin6_addr);
  port = six.sin6_port;
  return IN6_IS_ADDR_LOOPBACK(&six.sin6_addr);
}

/// \return nullopt if the connection is not over loopback
std::optional<Ends> ends_of(int descriptor) {
  sockaddr_storage own{};
  sockaddr_storage peer{};
  socklen_t own_size = sizeof own;
  socklen_t peer_size = sizeof peer;
  Ends ends;
  if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&own), &own_size) != 0 ||
      getpeername(descriptor, reinterpret_cast<sockaddr*>(&peer), &peer_size) != 0 ||
      !read_end(own, ends, ends.to, ends.to_port) || !read_end(peer, ends, ends.from, ends.from_port))
    return std::nullopt;
  return ends;
}

struct Answer {
  bool asked = false;  ///< the kernel answered the question
  std::optional<uid_t> user;
};

/// Asks the kernel for this one socket.
Answer ask_kernel(const Ends& ends) {
  const int netlink = socket(AF_NETLINK, SOCK_DGRAM | SOCK_CLOEXEC, NETLINK_SOCK_DIAG);
  if (netlink < 0) return {};
  const std::unique_ptr<const int, void (*)(const int*)> closing(&netlink, [](const int* open) { close(*open); });
  struct {
    nlmsghdr head{};
    inet_diag_req_v2 question{};
  } request;
  request.head.nlmsg_len = sizeof request;
  request.head.nlmsg_type = SOCK_DIAG_BY_FAMILY;
  request.head.nlmsg_flags = NLM_F_REQUEST;
  auto& question = request.question;
  question.sdiag_family = static_cast<std::uint8_t>(ends.family);
  question.sdiag_protocol = IPPROTO_TCP;
  question.idiag_states = ~0U;
  question.id.idiag_sport = ends.from_port;
  question.id.idiag_dport = ends.to_port;
  std::copy(ends.from.begin(), ends.from.end(), question.id.idiag_src);
  std::copy(ends.to.begin(), ends.to.end(), question.id.idiag_dst);
  question.id.idiag_cookie[0] = INET_DIAG_NOCOOKIE;
  question.id.idiag_cookie[1] = INET_DIAG_NOCOOKIE;
  if (send(netlink, &request, sizeof request, 0) < 0) return {};
  alignas(nlmsghdr) std::array<char, 8192> bytes{};
  const auto size = recv(netlink, bytes.data(), bytes.size(), 0);
  const auto* const head = reinterpret_cast<const nlmsghdr*>(bytes.data());
  if (size < static_cast<ssize_t>(sizeof(nlmsghdr))) return {};
  if (head->nlmsg_type == NLMSG_ERROR) {
    const auto* const error = reinterpret_cast<const nlmsgerr*>(bytes.data() + sizeof(nlmsghdr));
    return {size >= static_cast<ssize_t>(sizeof(nlmsghdr) + sizeof(nlmsgerr)) && error->error == -ENOENT, {}};
  }
  if (size < static_cast<ssize_t>(sizeof(nlmsghdr) + sizeof(inet_diag_msg))) return {};
  const auto* const found = reinterpret_cast<const inet_diag_msg*>(bytes.data() + sizeof(nlmsghdr));
  if (found->id.idiag_sport != ends.from_port || found->id.idiag_dport != ends.to_port) return {};
  // A socket that its process has closed belongs to nobody, and would be said to be root's.
  if (found->idiag_inode == 0) return {true, {}};
  return {true, found->idiag_uid};
}

std::string table_form(int family, const std::array<std::uint32_t, 4>& address, std::uint16_t port) {
  std::string text;
  for (std::size_t i = 0; i < (family == AF_INET ? 1U : 4U); ++i) text += fmt::format("{:08X}", address.at(i));
  return text + fmt::format(":{:04X}", ntohs(port));
}

/// Looks the socket up in the kernel's table of connections.
std::optional<uid_t> read_table(const Ends& ends) {
  std::ifstream in(ends.family == AF_INET ? "/proc/net/tcp" : "/proc/net/tcp6");
  const std::string from = table_form(ends.family, ends.from, ends.from_port);
  const std::string to = table_form(ends.family, ends.to, ends.to_port);
  std::string line;
  std::getline(in, line);
  while (std::getline(in, line)) {
    std::istringstream words(line);
    std::string number, own, peer, state, queues, timer, retries;
    uid_t user = 0;
    std::uint64_t timeout = 0, inode = 0;
    if (!(words >> number >> own >> peer >> state >> queues >> timer >> retries >> user >> timeout >> inode)) continue;
    if (own == from && peer == to) return inode == 0 ? std::nullopt : std::optional<uid_t>(user);
  }
  return std::nullopt;
}

}  // namespace

std::optional<uid_t> peer_user(int descriptor) {
  const auto ends = ends_of(descriptor);
  if (!ends) return std::nullopt;
  const Answer answer = ask_kernel(*ends);
  return answer.asked ? answer.user : read_table(*ends);
}

bool is_trusted_user(uid_t user, const std::vector<std::string>& accounts) {
  if (user == 0 || user == geteuid()) return true;
  return std::any_of(accounts.begin(), accounts.end(), [user](const std::string& name) {
    passwd entry{};
    passwd* found = nullptr;
    std::array<char, 16384> strings{};
    return getpwnam_r(name.c_str(), &entry, strings.data(), strings.size(), &found) == 0 && found != nullptr &&
           entry.pw_uid == user;
  });
}

}  // namespace iotcloud::rpc
