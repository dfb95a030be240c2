#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>

namespace iotcloud::config {

namespace {

constexpr const char* new_suffix = ".new-";  ///< of a new file's name; the id of the process that makes it follows

[[noreturn]] void fail(const std::string& path, const char* what, int problem) {
  throw Error(fmt::format("{} cannot be {}: {}", path, what, std::strerror(problem)));
}

std::string folder_of(const std::string& file) {
  const auto slash = file.rfind('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : file.substr(0, slash);
}

/// \return 0 or the error number
int write_and_sync(int descriptor, std::string_view text) {
  while (!text.empty()) {
    const auto written = write(descriptor, text.data(), text.size());
    if (written < 0 && errno != EINTR) return errno;
    if (written > 0) text.remove_prefix(static_cast<std::size_t>(written));
  }
  return fsync(descriptor) == 0 ? 0 : errno;
}

/// Makes the file and brings its text, but not its name, to the disk.
void make_file(const std::string& file, std::string_view text, unsigned permissions) {
  const int descriptor = open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, permissions);
  if (descriptor < 0) fail(file, "made", errno);
  const int problem = write_and_sync(descriptor, text);
  close(descriptor);
  if (problem == 0) return;
  unlink(file.c_str());
  fail(file, "written", problem);
}

/// Removes the new files that processes left beside `file` when they were killed. A file of a process that lives stays.
void remove_left_ones(const std::string& file) {
  const std::string prefix = std::filesystem::path(file).filename().string() + new_suffix;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder_of(file), error), end; !error && entry != end;
       entry.increment(error)) {
    const std::string name = entry->path().filename();
    if (!name.starts_with(prefix)) continue;
    const auto process = parse_number<pid_t>(std::string_view(name).substr(prefix.size()));
    if (process && *process > 0 && kill(*process, 0) != 0 && errno == ESRCH) unlink(entry->path().c_str());
  }
}

}  // namespace

void sync_folder(const std::string& folder) {
  const int descriptor = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) fail(folder, "opened", errno);
  const int problem = fsync(descriptor) == 0 ? 0 : errno;
  close(descriptor);
  if (problem != 0) fail(folder, "brought to the disk", problem);
}

void write_new_file(const std::string& file, std::string_view text, unsigned permissions) {
  make_file(file, text, permissions);
  try {
    sync_folder(folder_of(file));
  } catch (const Error&) {
    unlink(file.c_str());
    throw;
  }
}

Replacement::Replacement(std::string file, std::string_view text, unsigned permissions)
    : file_(std::move(file)), fresh_(fmt::format("{}{}{}", file_, new_suffix, getpid())) {
  remove_left_ones(file_);
  unlink(fresh_.c_str());  // a process with this id left it behind when it was killed
  make_file(fresh_, text, permissions);
}

Replacement::~Replacement() {
  if (!replaced_) unlink(fresh_.c_str());
}

void Replacement::replace() {
  if (std::rename(fresh_.c_str(), file_.c_str()) != 0) fail(file_, "replaced", errno);
  replaced_ = true;
  sync_folder(folder_of(file_));
}

void replace_file(const std::string& file, std::string_view text, unsigned permissions) {
  Replacement(file, text, permissions).replace();
}

}  // namespace iotcloud::config
