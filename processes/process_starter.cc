#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/logger.h>
#include <iotcloud/processes/process_starter.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

namespace {

constexpr std::chrono::milliseconds answer_limit{10000}, status_limit{5000};
constexpr std::string_view run_verb = "run", kill_verb = "kill";
/// Variables of the account under which the process runs, not of the daemon that asks.
constexpr std::array of_the_account = {"HOME", "USER", "LOGNAME"};
constexpr std::size_t most_descriptors = 2;
constexpr const char* acknowledged = "+";

/// Words of a request or an answer, each ended by a zero byte.
std::string body_of(const std::vector<std::string>& words) {
  std::string body;
  for (const auto& word : words) (body += word) += '\0';
  return body;
}

std::vector<std::string> words_of(const std::string& body) {
  std::vector<std::string> words;
  for (std::size_t begin = 0, end = 0; (end = body.find('\0', begin)) != std::string::npos; begin = end + 1) {
    words.push_back(body.substr(begin, end - begin));
  }
  return words;
}

std::optional<int> number_in(const std::string& word) {
  int number = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
  if (error != std::errc{} || end != word.data() + word.size()) return std::nullopt;
  return number;
}

/// Sends a frame, its first byte with the descriptors.
bool send_with(const OwnedDescriptor& socket, const std::string& bytes, const std::vector<int>& descriptors) {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * most_descriptors)> control{};
  iovec first{const_cast<char*>(bytes.data()), 1};
  msghdr message{};
  message.msg_iov = &first;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = CMSG_SPACE(sizeof(int) * descriptors.size());
  cmsghdr* const header = CMSG_FIRSTHDR(&message);
  header->cmsg_level = SOL_SOCKET;
  header->cmsg_type = SCM_RIGHTS;
  header->cmsg_len = CMSG_LEN(sizeof(int) * descriptors.size());
  std::memcpy(CMSG_DATA(header), descriptors.data(), sizeof(int) * descriptors.size());
  return sendmsg(socket.get(), &message, MSG_NOSIGNAL) == 1 && send_all(socket, bytes.substr(1));
}

/// Receives the first byte of a frame and the descriptors that come with it.
std::vector<OwnedDescriptor> receive_first(const OwnedDescriptor& socket, FrameReader& frames) {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * most_descriptors)> control{};
  char byte = 0;
  iovec first{&byte, 1};
  msghdr message{};
  message.msg_iov = &first;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  std::vector<OwnedDescriptor> found;
  if (!wait_readable(socket.get(), answer_limit) || recvmsg(socket.get(), &message, MSG_CMSG_CLOEXEC) != 1)
    return found;
  frames.feed(&byte, 1);
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
    for (std::size_t at = 0; at + CMSG_LEN(sizeof(int)) <= header->cmsg_len; at += sizeof(int)) {
      int descriptor = -1;
      std::memcpy(&descriptor, CMSG_DATA(header) + at, sizeof(int));
      found.emplace_back(descriptor);
    }
  }
  return found;
}

/// The words of the next frame; nullopt when the other side closes the connection, or `limit` passes in silence.
std::optional<std::vector<std::string>> next_words(const OwnedDescriptor& socket, FrameReader& frames,
                                                   std::chrono::milliseconds limit) {
  for (;;) {
    if (const auto body = frames.next()) return words_of(*body);
    if (!wait_readable(socket.get(), limit)) return std::nullopt;
    const auto bytes = receive_some(socket);
    if (!bytes) return std::nullopt;
    frames.feed(bytes->data(), bytes->size());
  }
}

void send_words(const OwnedDescriptor& socket, const std::vector<std::string>& words) {
  send_all(socket, frame(body_of(words)));
}

/// Runs the program, and tells the other side its process id. When the program has ended and the other side has taken
/// up the id, tells it how the program ended. The process is reaped only when the other side has closed the connection,
/// so no other process gets the id before.
int run(const OwnedDescriptor& connection, const std::string& program, std::vector<std::string> arguments,
        std::vector<std::string> environment, std::vector<OwnedDescriptor> descriptors) {
  arguments.front() = program;
  for (const char* name : of_the_account) {
    const std::string begin = std::string(name) + "=";
    environment.erase(std::remove_if(environment.begin(), environment.end(),
                                     [&](const auto& variable) { return variable.starts_with(begin); }),
                      environment.end());
    if (const char* value = std::getenv(name)) environment.push_back(begin + value);
  }
  const int process = spawn(std::move(arguments), descriptors[0], descriptors[1], std::move(environment));
  descriptors.clear();  // nobody is to listen on its socket when it has ended
  send_words(connection, {"started", std::to_string(process)});
  siginfo_t ended{};
  while (waitid(P_PID, static_cast<id_t>(process), &ended, WEXITED | WNOWAIT) != 0 && errno == EINTR) {
  }
  const int status = ended.si_code == CLD_EXITED ? W_EXITCODE(ended.si_status, 0) : W_EXITCODE(0, ended.si_status);
  char received = 0;
  if (recv(connection.get(), &received, 1, 0) == 1) send_words(connection, {"ended", std::to_string(status)});
  while (recv(connection.get(), &received, 1, 0) > 0) {
  }
  return 0;
}

}  // namespace

ProcessStarter::ProcessStarter(std::string socket) : socket_(std::move(socket)) {
  if (access(socket_.c_str(), W_OK) != 0) {
    throw config::Error(
        fmt::format("the socket {}, at which driver hosts are started, cannot be used: {}; systemctl enable --now "
                    "iotcloud-host.socket makes it, for the user iotcloud-gateway",
                    socket_, std::strerror(errno)));
  }
}

OwnedDescriptor ProcessStarter::connect() const {
  const auto slash = socket_.rfind('/');
  return slash == std::string::npos ? connect_in(".", socket_)
                                    : connect_in(socket_.substr(0, slash + 1), socket_.substr(slash + 1));
}

ProcessStarter::Started ProcessStarter::start(const std::vector<std::string>& arguments,
                                              const std::vector<std::string>& environment, const OwnedDescriptor& log,
                                              const OwnedDescriptor& passed) const {
  OwnedDescriptor connection = connect();
  if (!connection) {
    throw config::Error(fmt::format("nobody starts a process at {}: {}; is iotcloud-host.socket active?", socket_,
                                    std::strerror(errno)));
  }
  std::vector<std::string> words = {std::string(run_verb), std::to_string(arguments.size())};
  words.insert(words.end(), arguments.begin(), arguments.end());
  words.insert(words.end(), environment.begin(), environment.end());
  FrameReader frames;
  if (send_with(connection, frame(body_of(words)), {log.get(), passed.get()})) {
    const auto answer = next_words(connection, frames, answer_limit);
    if (answer && answer->size() == 2 && answer->front() == "started") {
      if (const auto process = number_in(answer->back()); process && send_all(connection, acknowledged)) {
        return {*process, std::move(connection)};
      }
    }
    if (answer && answer->size() == 2) throw config::Error(answer->back());
  }
  throw config::Error(
      fmt::format("no process was started at {}; journalctl -u 'iotcloud-host@*' may say why", socket_));
}

bool ProcessStarter::kill(int pidfd) const noexcept try {
  const OwnedDescriptor connection = connect();
  FrameReader frames;
  if (!connection || !send_with(connection, frame(body_of({std::string(kill_verb)})), {pidfd})) return false;
  const auto answer = next_words(connection, frames, answer_limit);
  return answer && answer->front() == "killed";
} catch (const std::exception& e) {
  logger.error("a process of another user cannot be killed at {}: {}", socket_, e.what());
  return false;
}

std::optional<int> status_of(const OwnedDescriptor& connection) {
  FrameReader frames;
  const auto words = next_words(connection, frames, status_limit);
  if (!words || words->size() != 2 || words->front() != "ended") return std::nullopt;
  return number_in(words->back());
}

int serve_starter(OwnedDescriptor connection, const std::string& program) try {
  FrameReader frames;
  auto descriptors = receive_first(connection, frames);
  auto words = next_words(connection, frames, answer_limit);
  if (!words || words->empty()) throw config::Error("a request of the gateway did not come whole");
  if (words->front() == kill_verb && words->size() == 1 && descriptors.size() == 1) {
    const long sent = syscall(SYS_pidfd_send_signal, descriptors[0].get(), SIGKILL, nullptr, 0);
    if (sent != 0) throw config::Error(fmt::format("the process cannot be killed: {}", std::strerror(errno)));
    send_words(connection, {"killed"});
    return 0;
  }
  const auto count = words->size() > 2 && words->front() == run_verb ? number_in((*words)[1]) : std::nullopt;
  if (!count || *count < 1 || static_cast<std::size_t>(*count) > words->size() - 2 || descriptors.size() != 2) {
    throw config::Error("this request of the gateway is none that this version knows");
  }
  const auto first = words->begin() + 2;
  return run(connection, program, {first, first + *count}, {first + *count, words->end()}, std::move(descriptors));
} catch (const config::Error& e) {
  logger.error("{}", e.what());
  send_words(connection, {"failed", e.what()});
  return 1;
}

}  // namespace iotcloud::processes
