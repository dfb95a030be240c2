#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/plugins/sibling_program.h>

namespace iotcloud::master::cli {

namespace {

/// A pipe whose ends close with it.
struct Pipe {
  Pipe() {
    if (pipe2(ends.data(), O_CLOEXEC) != 0) throw config::Error(fmt::format("no pipe: {}", std::strerror(errno)));
  }
  ~Pipe() {
    close(ends[0]);
    close_writing_end();
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  void close_writing_end() {
    if (ends[1] >= 0) close(ends[1]);
    ends[1] = -1;
  }
  std::array<int, 2> ends{-1, -1};
};

pid_t start(const std::string& path, std::vector<std::string> words, int output) {
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, output, STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, output, STDERR_FILENO);
  pid_t child = 0;
  const int problem = posix_spawn(&child, path.c_str(), &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (problem != 0) throw config::Error(fmt::format("{} cannot be started: {}", path, std::strerror(problem)));
  return child;
}

std::string path_of(const std::string& program) {
  namespace fs = std::filesystem;
  const fs::path path = fs::read_symlink("/proc/self/exe").parent_path() / program;
  if (!fs::exists(path))
    throw config::Error(fmt::format("this needs the program {}, which is not in {}; install it beside iotcloud",
                                    program, path.parent_path().string()));
  return path;
}

}  // namespace

ProgramEnd run_sibling(const std::string& program, const std::vector<std::string>& arguments) {
  const std::string path = path_of(program);
  Pipe pipe;
  std::vector<std::string> words{path};
  words.insert(words.end(), arguments.begin(), arguments.end());
  const pid_t child = start(path, std::move(words), pipe.ends[1]);
  pipe.close_writing_end();
  ProgramEnd ended;
  std::array<char, 4096> buffer{};
  for (ssize_t got = 0; (got = read(pipe.ends[0], buffer.data(), buffer.size())) != 0;) {
    if (got > 0) ended.output.append(buffer.data(), static_cast<std::size_t>(got));
    if (got < 0 && errno != EINTR) break;
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (WIFSIGNALED(status)) ended.signal = WTERMSIG(status);
  if (WIFEXITED(status)) ended.status = WEXITSTATUS(status);
  return ended;
}

void become_sibling(const std::string& program, const std::vector<std::string>& arguments) {
  std::vector<std::string> words{path_of(program)};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv(argv.front(), argv.data());
  throw config::Error(fmt::format("{} cannot be started: {}", words.front(), std::strerror(errno)));
}

}  // namespace iotcloud::master::cli
