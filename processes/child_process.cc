#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/child_process.h>

namespace iotcloud::processes {

namespace {

/// What a program needs to run as its user wants it; nothing of it is a secret. The last ones are settings of the
/// sanitizers' builds.
constexpr std::array usual_variables = {
    "HOME", "LANG",   "LC_ALL", "LC_CTYPE", "LC_MESSAGES",  "LC_NUMERIC",   "LC_TIME",      "LOGNAME",
    "PATH", "TMPDIR", "TZ",     "USER",     "ASAN_OPTIONS", "LSAN_OPTIONS", "TSAN_OPTIONS", "UBSAN_OPTIONS"};

/// Settings that keep a child from inheriting the session, signals and descriptors (sockets above all).
class Spawning {
 public:
  /// \param passed -1: none
  explicit Spawning(int log, int passed = -1) {
    posix_spawn_file_actions_init(&actions_);
    posix_spawn_file_actions_addopen(&actions_, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_adddup2(&actions_, log, STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions_, log, STDERR_FILENO);
    int last = STDERR_FILENO;
    if (passed >= 0) posix_spawn_file_actions_adddup2(&actions_, passed, ++last);
    posix_spawn_file_actions_addclosefrom_np(&actions_, last + 1);
    set_attributes();
  }
  ~Spawning() {
    posix_spawn_file_actions_destroy(&actions_);
    posix_spawnattr_destroy(&attributes_);
  }
  Spawning(const Spawning&) = delete;
  Spawning& operator=(const Spawning&) = delete;

  pid_t spawn(std::vector<std::string> arguments, std::vector<std::string> environment) {
    const auto argv = pointers_to(arguments);
    const auto variables = pointers_to(environment);
    pid_t child = 0;
    const int error = posix_spawn(&child, argv[0], &actions_, &attributes_, argv.data(), variables.data());
    if (error != 0) throw config::Error(fmt::format("{} cannot be started: {}", arguments[0], std::strerror(error)));
    return child;
  }

 private:
  void set_attributes() {
    posix_spawnattr_init(&attributes_);
    posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSID | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    sigset_t set;
    sigemptyset(&set);
    posix_spawnattr_setsigmask(&attributes_, &set);
    sigfillset(&set);
    posix_spawnattr_setsigdefault(&attributes_, &set);
  }

  static std::vector<char*> pointers_to(std::vector<std::string>& texts) {
    std::vector<char*> pointers;
    pointers.reserve(texts.size() + 1);
    for (auto& text : texts) pointers.push_back(text.data());
    pointers.push_back(nullptr);
    return pointers;
  }

  posix_spawn_file_actions_t actions_;
  posix_spawnattr_t attributes_;
};

/// Opens a log, in whose folder another process may have put something else in its place.
OwnedDescriptor open_for_output(const std::string& path) {
  constexpr mode_t only_owner = 0600;
  OwnedDescriptor log(
      open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, only_owner));
  struct stat status {};
  if (!log) throw config::Error(fmt::format("the log {} cannot be opened: {}", path, std::strerror(errno)));
  if (fstat(log.get(), &status) != 0 || !S_ISREG(status.st_mode))
    throw config::Error(fmt::format("the log {} is not a file: somebody has put something else there", path));
  fcntl(log.get(), F_SETFL, O_APPEND);  // the child's writes wait
  return log;
}

}  // namespace

int spawn(std::vector<std::string> arguments, const std::string& log_file, std::vector<std::string> environment) {
  const auto log = open_for_output(log_file);
  return Spawning(log.get()).spawn(std::move(arguments), std::move(environment));
}

int spawn(std::vector<std::string> arguments, const OwnedDescriptor& log, const OwnedDescriptor& passed,
          std::vector<std::string> environment) {
  return Spawning(log.get(), passed.get()).spawn(std::move(arguments), std::move(environment));
}

std::vector<std::string> environment_of(const std::vector<std::string>& more) {
  std::vector<std::string> names(usual_variables.begin(), usual_variables.end());
  names.insert(names.end(), more.begin(), more.end());
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  std::vector<std::string> environment;
  for (const auto& name : names) {
    if (const char* value = std::getenv(name.c_str())) environment.push_back(name + "=" + value);
  }
  return environment;
}

std::string own_program() {
  std::error_code error;
  return std::filesystem::read_symlink("/proc/self/exe", error);
}

std::string program_beside(const std::string& name) {
  return std::filesystem::path(own_program()).parent_path() / name;
}

std::optional<bool> has_argument(int process, const std::string& argument) {
  if (process <= 0 || (::kill(process, 0) != 0 && errno == ESRCH)) return false;
  const OwnedDescriptor file(open(fmt::format("/proc/{}/cmdline", process).c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) return std::nullopt;
  std::string arguments(1, '\0');
  std::array<char, 4096> part{};
  ssize_t size = 0;
  while ((size = read(file.get(), part.data(), part.size())) > 0) {
    arguments.append(part.data(), static_cast<std::size_t>(size));
  }
  if (size < 0 && errno != ESRCH) return std::nullopt;
  return arguments.find('\0' + argument + '\0') != std::string::npos;
}

ChildProcess::ChildProcess(int process, bool own)
    : process_(process), own_(own), descriptor_(static_cast<int>(syscall(SYS_pidfd_open, process, 0))) {}

ChildProcess::ChildProcess(ProcessStarter::Started started, std::shared_ptr<const ProcessStarter> starter)
    : ChildProcess(started.process, std::move(starter)) {
  starters_connection_ = std::move(started.connection);
}

ChildProcess::ChildProcess(int process, std::shared_ptr<const ProcessStarter> starter) : ChildProcess(process, false) {
  starter_ = std::move(starter);
}

bool ChildProcess::wait(std::chrono::milliseconds limit) const {
  return !descriptor_ || wait_readable(descriptor_.get(), limit);
}

void ChildProcess::kill() const noexcept {
  if (!descriptor_ || syscall(SYS_pidfd_send_signal, descriptor_.get(), SIGKILL, nullptr, 0) == 0) return;
  if (errno == EPERM && starter_) starter_->kill(descriptor_.get());
}

std::optional<int> ChildProcess::status() const {
  if (starters_connection_) return status_of(starters_connection_);
  int status = 0;
  if (!own_ || waitpid(process_, &status, 0) != process_) return std::nullopt;
  return status;
}

std::string ChildProcess::how_it_ended() const {
  const auto known = status();
  if (!known) return "died";
  if (WIFSIGNALED(*known)) {
    return fmt::format("crashed (signal {}, {})", WTERMSIG(*known), strsignal(WTERMSIG(*known)));
  }
  return fmt::format("exited with status {}", WEXITSTATUS(*known));
}

}  // namespace iotcloud::processes
