#include <algorithm>
#include <array>
#include <cerrno>
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
#include <iotcloud/processes/starter_protocol.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

namespace {

constexpr std::chrono::milliseconds answer_limit{10000}, status_limit{5000};
/// Variables of the account under which the process runs, not of the daemon that asks.
constexpr std::array of_the_account = {"HOME", "USER", "LOGNAME"};
constexpr const char* acknowledged = "+";

/// Sends a frame, its first byte with the descriptors.
bool send_frame(const OwnedDescriptor& socket, const std::string& bytes, const std::vector<int>& descriptors) {
  return send_with(socket, bytes.substr(0, 1), descriptors) == 1 && send_all(socket, bytes.substr(1));
}

/// Receives the first byte of a frame and the descriptors that come with it.
std::vector<OwnedDescriptor> receive_first(const OwnedDescriptor& socket, FrameReader& frames) {
  if (!wait_readable(socket.get(), answer_limit)) return {};
  auto passed = receive_with(socket, 1);
  if (!passed || passed->bytes.empty()) return {};
  frames.feed(passed->bytes.data(), passed->bytes.size());
  return std::move(passed->descriptors);
}

/// The body of the next frame; nullopt when the other side closes the connection, or `limit` passes in silence.
std::optional<std::string> next_body(const OwnedDescriptor& socket, FrameReader& frames,
                                     std::chrono::milliseconds limit) {
  for (;;) {
    if (auto body = frames.next()) return body;
    if (!wait_readable(socket.get(), limit)) return std::nullopt;
    const auto bytes = receive_some(socket);
    if (!bytes) return std::nullopt;
    frames.feed(bytes->data(), bytes->size());
  }
}

std::optional<StarterAnswer> next_answer(const OwnedDescriptor& socket, std::chrono::milliseconds limit) {
  FrameReader frames;
  const auto body = next_body(socket, frames, limit);
  return body ? std::optional(decode_answer(*body)) : std::nullopt;
}

/// Runs the program, and tells the other side its process id. When the program has ended and the other side has taken
/// up the id, tells it how the program ended. The process is reaped only when the other side has closed the connection,
/// so no other process gets the id before.
int run(const OwnedDescriptor& connection, const std::string& program, StarterRequest request,
        std::vector<OwnedDescriptor> descriptors) {
  request.arguments.front() = program;
  auto& environment = request.environment;
  for (const char* name : of_the_account) {
    const std::string begin = std::string(name) + "=";
    environment.erase(std::remove_if(environment.begin(), environment.end(),
                                     [&](const auto& variable) { return variable.starts_with(begin); }),
                      environment.end());
    if (const char* value = std::getenv(name)) environment.push_back(begin + value);
  }
  const int process = spawn(std::move(request.arguments), descriptors[0], descriptors[1], std::move(environment));
  descriptors.clear();  // nobody is to listen on its socket when it has ended
  send_all(connection, encode(StarterAnswer{StarterAnswer::Kind::started, process, {}}));
  siginfo_t ended{};
  while (waitid(P_PID, static_cast<id_t>(process), &ended, WEXITED | WNOWAIT) != 0 && errno == EINTR) {
  }
  const int status = ended.si_code == CLD_EXITED ? W_EXITCODE(ended.si_status, 0) : W_EXITCODE(0, ended.si_status);
  char received = 0;
  if (recv(connection.get(), &received, 1, 0) == 1) {
    send_all(connection, encode(StarterAnswer{StarterAnswer::Kind::ended, status, {}}));
  }
  while (recv(connection.get(), &received, 1, 0) > 0) {
  }
  return 0;
}

}  // namespace

ProcessStarter::ProcessStarter(std::string socket, std::string unit)
    : socket_(std::move(socket)), unit_(std::move(unit)) {
  if (access(socket_.c_str(), W_OK) != 0) {
    throw config::Error(
        fmt::format("the socket {}, at which processes of another user are started, cannot be used: {}; systemctl "
                    "enable --now {}.socket makes it, for the user that its SocketUser= names",
                    socket_, std::strerror(errno), unit_));
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
    throw config::Error(
        fmt::format("nobody starts a process at {}: {}; is {}.socket active?", socket_, std::strerror(errno), unit_));
  }
  const StarterRequest request{StarterRequest::Kind::run, arguments, environment};
  if (send_frame(connection, encode(request), {log.get(), passed.get()})) {
    const auto answer = next_answer(connection, answer_limit);
    if (answer && answer->kind == StarterAnswer::Kind::failed) throw config::Error(answer->reason);
    // Our own process id as an answer would be dangerous: the caller ends a started process that has another account
    // than it should.
    if (answer && answer->kind == StarterAnswer::Kind::started && answer->number != getpid() &&
        send_all(connection, acknowledged)) {
      return {answer->number, std::move(connection)};
    }
  }
  throw config::Error(fmt::format("no process was started at {}; journalctl -u '{}@*' may say why", socket_, unit_));
}

bool ProcessStarter::kill(int pidfd) const noexcept try {
  const OwnedDescriptor connection = connect();
  const StarterRequest request{StarterRequest::Kind::kill, {}, {}};
  if (!connection || !send_frame(connection, encode(request), {pidfd})) return false;
  const auto answer = next_answer(connection, answer_limit);
  return answer && answer->kind == StarterAnswer::Kind::killed;
} catch (const std::exception& e) {
  logger.error("a process of another user cannot be killed at {}: {}", socket_, e.what());
  return false;
}

std::optional<int> status_of(const OwnedDescriptor& connection) try {
  const auto answer = next_answer(connection, status_limit);
  if (!answer || answer->kind != StarterAnswer::Kind::ended) return std::nullopt;
  return answer->number;
} catch (const config::Error& e) {
  logger.error("how a process of another user ended is not known: {}", e.what());
  return std::nullopt;
}

int serve_starter(OwnedDescriptor connection, const std::string& program) try {
  FrameReader frames;
  auto descriptors = receive_first(connection, frames);
  const auto body = next_body(connection, frames, answer_limit);
  if (!body) throw config::Error("a request did not come whole");
  StarterRequest request = decode_request(*body);
  if (descriptors.size() != request.descriptors()) {
    throw config::Error(
        fmt::format("a request came with {} descriptors instead of {}", descriptors.size(), request.descriptors()));
  }
  if (request.kind == StarterRequest::Kind::run) {
    return run(connection, program, std::move(request), std::move(descriptors));
  }
  if (syscall(SYS_pidfd_send_signal, descriptors[0].get(), SIGKILL, nullptr, 0) != 0) {
    throw config::Error(fmt::format("the process cannot be killed: {}", std::strerror(errno)));
  }
  send_all(connection, encode(StarterAnswer{StarterAnswer::Kind::killed, 0, {}}));
  return 0;
} catch (const config::Error& e) {
  logger.error("{}", e.what());
  send_all(connection, encode(StarterAnswer{StarterAnswer::Kind::failed, 0, e.what()}));
  return 1;
}

}  // namespace iotcloud::processes
