#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/drivers/exec/exec_driver.h>

namespace iotcloud::drivers::exec {

namespace {

/// The two ends of a pipe, closed with this object unless they were taken.
struct Pipe {
  Pipe() {
    std::array<int, 2> ends{-1, -1};
    if (pipe2(ends.data(), O_CLOEXEC) != 0) throw std::runtime_error(std::string("no pipe: ") + std::strerror(errno));
    out = ends[0];
    in = ends[1];
  }
  ~Pipe() {
    close_end(out);
    close_end(in);
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;

  static void close_end(int& end) {
    if (end >= 0) ::close(std::exchange(end, -1));
  }
  /// The end, which never blocks and is the caller's.
  static int take(int& end) {
    fcntl(end, F_SETFL, fcntl(end, F_GETFL) | O_NONBLOCK);
    return std::exchange(end, -1);
  }
  int out, in;
};

std::vector<char*> pointers(std::vector<std::string>& words) {
  std::vector<char*> all;
  all.reserve(words.size() + 1);
  for (std::string& word : words) all.push_back(word.data());
  all.push_back(nullptr);
  return all;
}

/// The file of a program; the name itself if no folder of PATH has it.
std::string path_of(const std::string& program) {
  const char* folders = std::getenv("PATH");
  if (program.find('/') != std::string::npos || folders == nullptr) return program;
  std::string rest = folders;
  while (!rest.empty()) {
    const auto colon = rest.find(':');
    std::string file = rest.substr(0, colon) + "/" + program;
    if (access(file.c_str(), X_OK) == 0) return file;
    rest = colon == std::string::npos ? "" : rest.substr(colon + 1);
  }
  return program;
}

/// What this process has of the variables that every program may have: not the brokers' passwords.
std::vector<std::string> usual_environment() {
  std::vector<std::string> all;
  for (const char* name : {"PATH", "HOME", "LANG", "LC_ALL", "TZ", "USER", "TMPDIR"}) {
    if (const char* value = std::getenv(name)) all.push_back(std::string(name) + "=" + value);
  }
  return all;
}

struct Start {
  const char* file;
  char** arguments;
  char** environment;
  const char* folder;
  int input, output, errors, problem;
};

/// In the new process, which has this process's memory: makes nothing but system calls. Never returns.
[[noreturn]] void become(const Start& start, pid_t parent) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // it does not outlive the driver host
  bool good = getppid() == parent;
  struct sigaction usual {};
  usual.sa_handler = SIG_DFL;
  for (int number = 1; number < NSIG; ++number) sigaction(number, &usual, nullptr);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  good = good && dup2(start.input, STDIN_FILENO) >= 0 && dup2(start.output, STDOUT_FILENO) >= 0 &&
         dup2(start.errors, STDERR_FILENO) >= 0 && chdir(start.folder) == 0;
  if (good) execve(start.file, start.arguments, start.environment);
  const int problem = errno;
  static_cast<void>(!write(start.problem, &problem, sizeof problem));
  _exit(127);
}

std::string how_it_ended(const siginfo_t& end) {
  if (end.si_code == CLD_EXITED) return "it exited with status " + std::to_string(end.si_status);
  return std::string("it was ended by the signal ") + strsignal(end.si_status);
}

}  // namespace

std::vector<std::string> words_of(const std::string& line) {
  std::vector<std::string> words;
  bool in_word = false;
  char quote = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    const bool blank = c == ' ' || c == '\t' || c == '\n';
    if (quote == 0 && blank) {
      in_word = false;
      continue;
    }
    if (!std::exchange(in_word, true)) words.emplace_back();
    if (c == quote) {
      quote = 0;
    } else if (quote == 0 && (c == '\'' || c == '"')) {
      quote = c;
    } else if (c == '\\' && quote != '\'' && i + 1 < line.size()) {
      words.back() += line[++i];
    } else {
      words.back() += c;
    }
  }
  if (quote != 0) throw std::invalid_argument(std::string("the quote ") + quote + " has no end");
  return words;
}

void ExecDriver::read(PropertyReader& reader) {
  ConnectingDriver::read(reader);
  const auto words = [&](const std::string& name) {
    try {
      return words_of(reader.text(name, ""));
    } catch (const std::invalid_argument& e) {
      throw std::invalid_argument("property \"" + name + "\": " + e.what());
    }
  };
  command_ = words("command");
  environment_ = words("environment");
  folder_ = reader.text("folder", "/");
  restart_ = reader.text("restart", "always");
  grace_ = std::chrono::milliseconds(reader.integer("grace_ms", 2000, 0, 8000));
  if (command_.empty())
    throw std::invalid_argument("property \"command\" is empty; it takes a program and its arguments");
  for (const std::string& variable : environment_) {
    if (variable.find('=') == std::string::npos || variable.front() == '=')
      throw std::invalid_argument("property \"environment\" has \"" + variable + "\"; it takes NAME=VALUE");
  }
}

void ExecDriver::connect() {
  Pipe input, output, errors, problem;
  std::vector<std::string> environment = usual_environment();
  environment.insert(environment.end(), environment_.begin(), environment_.end());
  const std::string file = path_of(command_.front());
  const auto arguments = pointers(command_), variables = pointers(environment);
  const Start start{file.c_str(),
                    const_cast<char**>(arguments.data()),
                    const_cast<char**>(variables.data()),
                    folder_.c_str(),
                    input.out,
                    output.in,
                    errors.in,
                    problem.in};
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child == 0) become(start, parent);
  Pipe::close_end(problem.in);
  int why = child < 0 ? errno : 0;
  if (child > 0 && ::read(problem.out, &why, sizeof why) > 0) waitpid(child, nullptr, 0);
  if (why != 0) return away(command_.front() + " cannot be started: " + std::strerror(why));
  process_ = child;  // which close() ends, whatever happens here
  how_.clear();
  errors_ = Pipe::take(errors.out);
  watch_program();
  connected(Pipe::take(output.out), Pipe::take(input.in), {{"process", std::to_string(process_)}});
}

void ExecDriver::watch_program() {
  handle_ = static_cast<int>(syscall(SYS_pidfd_open, process_, 0));  // closed when a program is executed
  if (handle_ < 0) throw std::runtime_error(std::string("cannot watch the program: ") + std::strerror(errno));
  handle_watch_ = context().on_readable(handle_, [this] { program_ended(); });
  errors_watch_ = context().on_readable(errors_, [this] { read_errors(); });
}

void ExecDriver::program_ended() {
  context().stop(*std::exchange(handle_watch_, std::nullopt));
  siginfo_t end{};
  waitid(P_PID, static_cast<id_t>(process_), &end, WEXITED | WNOWAIT);
  how_ = how_it_ended(end);
  if (end.si_code == CLD_EXITED && end.si_status == 0 && restart_ == "on-failure") restart_ = "never";
  // While it is not reaped, nobody else has its number. What it has started, and holds its output open, ends with it.
  kill(-process_, SIGKILL);
  waitid(P_PID, static_cast<id_t>(std::exchange(process_, -1)), &end, WEXITED);
  if (!has_link()) finish();
}

void ExecDriver::ended(const std::string& /*reason*/) {
  if (!how_.empty()) finish();
}

void ExecDriver::finish() {
  read_errors();
  release();
  context().update_metadata({{"process", ""}});
  if (restart_ != "never") return away("the program is not running: " + how_);
  tell_away("the program is not running, and is not started again (restart): " + how_);
}

void ExecDriver::read_errors() {
  if (errors_ < 0) return;
  // A program may write faster than this reads: then other handlers of the event thread have their turn.
  constexpr int reads_at_once = 32;
  std::array<char, 4096> buffer;
  for (int i = 0; i < reads_at_once; ++i) {
    const ssize_t count = ::read(errors_, buffer.data(), buffer.size());
    if (count > 0) {
      error_line_.append(buffer.data(), static_cast<std::size_t>(count));
      log_errors(false);
      continue;
    }
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
    log_errors(true);
    if (errors_watch_) context().stop(*std::exchange(errors_watch_, std::nullopt));
    Pipe::close_end(errors_);
    return;
  }
}

void ExecDriver::log_errors(bool last) {
  constexpr std::size_t longest_line = 4096;
  for (;;) {
    const auto end = error_line_.find('\n');
    if (end == std::string::npos && !(last && !error_line_.empty()) && error_line_.size() < longest_line) return;
    context().log(LogLevel::info, "the program says: " + error_line_.substr(0, end));
    error_line_.erase(0, end == std::string::npos ? end : end + 1);
  }
}

void ExecDriver::release() {
  if (handle_watch_) context().stop(*std::exchange(handle_watch_, std::nullopt));
  if (errors_watch_) context().stop(*std::exchange(errors_watch_, std::nullopt));
  Pipe::close_end(handle_);
  Pipe::close_end(errors_);
}

void ExecDriver::close() {
  drop_link();  // the end of its input
  if (process_ > 0) {
    kill(-process_, SIGTERM);
    pollfd ended{handle_, POLLIN, 0};
    poll(&ended, 1, static_cast<int>(grace_.count()));
    siginfo_t end{};
    kill(-process_, SIGKILL);
    waitid(P_PID, static_cast<id_t>(std::exchange(process_, -1)), &end, WEXITED);
    read_errors();
  }
  release();
  ConnectingDriver::close();
}

}  // namespace iotcloud::drivers::exec
