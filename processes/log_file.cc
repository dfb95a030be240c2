#include <cstdio>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/log_file.h>

namespace iotcloud::processes {

namespace {

bool is_the_same(const struct stat& a, const struct stat& b) {
  return a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}

}  // namespace

void LogFile::rotate_if_too_long() const {
  if (options_.path.empty()) return;
  struct stat written {};
  struct stat named {};
  if (fstat(STDOUT_FILENO, &written) != 0) return;
  if (stat(options_.path.c_str(), &named) != 0 || !is_the_same(written, named)) {
    follow();
  } else if (static_cast<std::uint64_t>(written.st_size) > options_.most_bytes) {
    move_log(options_, STDOUT_FILENO);
    follow();
  }
}

/// The lock ends when this process closes its last descriptor of the file.
bool move_log(const LogFile::Options& options, int written) {
  if (flock(written, LOCK_EX | LOCK_NB) != 0) return false;
  struct stat open_one {};
  struct stat named {};
  const bool grown = fstat(written, &open_one) == 0 && stat(options.path.c_str(), &named) == 0 &&
                     is_the_same(open_one, named) && static_cast<std::uint64_t>(open_one.st_size) > options.most_bytes;
  if (!grown) return false;
  const auto older = [&](int number) {
    return number == 0 ? options.path : fmt::format("{}.{}", options.path, number);
  };
  if (options.kept == 0) return unlink(options.path.c_str()) == 0;
  bool moved = false;
  for (int number = options.kept; number > 0; --number) {
    moved = std::rename(older(number - 1).c_str(), older(number).c_str()) == 0;
  }
  return moved;
}

void LogFile::follow() const {
  constexpr mode_t owner_only = S_IRUSR | S_IWUSR;
  const OwnedDescriptor fresh(open(options_.path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, owner_only));
  if (!fresh) return;  // keep writing to the old file
  dup2(fresh.get(), STDOUT_FILENO);
  dup2(fresh.get(), STDERR_FILENO);
}

}  // namespace iotcloud::processes
