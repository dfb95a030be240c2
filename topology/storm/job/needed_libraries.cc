#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <set>
#include <sstream>

#include <dlfcn.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/auxv.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/storm/job/needed_libraries.h>

namespace iotcloud::topology::storm {

namespace {

/// Parts of the C library, which belong together and to the machine's kernel and loader.
constexpr std::array c_library{"libc.so.",    "libm.so.",    "libdl.so.",     "libpthread.so.",
                               "librt.so.",   "libutil.so.", "libresolv.so.", "libanl.so.",
                               "libmvec.so.", "ld-linux",    "linux-vdso"};

/// The dynamic loader of this process.
std::string loader() {
  Dl_info info{};
  const auto base = getauxval(AT_BASE);
  if (base == 0 || dladdr(reinterpret_cast<void*>(base), &info) == 0)  // NOLINT(performance-no-int-to-ptr)
    throw config::Error("this program's dynamic loader cannot be found");
  return info.dli_fname;
}

/// What `loader --list FILE` writes: "\tNAME => PATH (ADDRESS)" for each library, as ldd shows it.
std::string list(const std::string& program, const std::string& file) {
  std::array<int, 2> ends{};
  if (pipe2(ends.data(), O_CLOEXEC) != 0) throw config::Error(fmt::format("no pipe: {}", std::strerror(errno)));
  std::string name = program;
  std::string option = "--list";
  std::string path = file;
  std::array<char*, 4> words{name.data(), option.data(), path.data(), nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, ends[1], STDERR_FILENO);
  pid_t child = 0;
  const int problem = posix_spawn(&child, program.c_str(), &actions, nullptr, words.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[1]);
  std::string output;
  std::array<char, 4096> buffer{};
  for (ssize_t got = 0; problem == 0 && (got = read(ends[0], buffer.data(), buffer.size())) != 0;) {
    if (got > 0) output.append(buffer.data(), static_cast<std::size_t>(got));
    if (got < 0 && errno != EINTR) break;
  }
  close(ends[0]);
  if (problem != 0) throw config::Error(fmt::format("{} cannot be started: {}", program, std::strerror(problem)));
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (status != 0) throw config::Error(fmt::format("what {} needs cannot be listed: {}", file, output));
  return output;
}

bool is_of_c_library(const std::string& name) {
  return std::any_of(c_library.begin(), c_library.end(), [&](const char* part) { return name.starts_with(part); });
}

}  // namespace

NeededLibraries needed_libraries(const std::vector<std::string>& files) {
  namespace fs = std::filesystem;
  std::set<std::string> own;
  for (const auto& file : files) own.insert(fs::path(file).filename());
  std::set<std::string> taken;
  std::set<std::string> expected;
  for (const auto& file : files) {
    std::istringstream lines(list(loader(), file));
    for (std::string line; std::getline(lines, line);) {
      std::istringstream words(line);
      std::string name;
      std::string arrow;
      std::string path;
      words >> name >> arrow >> path;
      const std::string base = fs::path(name).filename();
      if (base.empty() || own.contains(base)) continue;
      if (is_of_c_library(base)) {
        if (!base.starts_with("linux-vdso")) expected.insert(base);
      } else if (path == "not" || arrow != "=>") {
        throw config::Error(fmt::format("{} needs {}, which is not installed here", file, name));
      } else {
        taken.insert(path);
      }
    }
  }
  return {{taken.begin(), taken.end()}, {expected.begin(), expected.end()}};
}

}  // namespace iotcloud::topology::storm
