#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/durable_file.h>

namespace iotcloud::processes {

namespace {

[[noreturn]] void fail(const std::string& path, const char* what) {
  throw config::Error(fmt::format("{} cannot be {}: {}", path, what, std::strerror(errno)));
}

}  // namespace

OwnedDescriptor create_file(const std::string& path) {
  OwnedDescriptor file(open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, S_IRUSR | S_IWUSR));
  if (!file) fail(path, "made");
  return file;
}

void write_all(const OwnedDescriptor& file, std::string_view bytes, const std::string& path) {
  while (!bytes.empty()) {
    const auto written = write(file.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) fail(path, "written");
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
}

void sync_file(const OwnedDescriptor& file, const std::string& path) {
  if (fsync(file.get()) != 0) fail(path, "brought to the disk");
}

std::string read_file(const std::string& path, std::size_t most) {
  const OwnedDescriptor file(open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  if (!file) fail(path, "opened");
  constexpr std::size_t piece = std::size_t{64} * 1024;
  std::string bytes;
  std::array<char, piece> buffer{};
  for (;;) {
    const auto got = read(file.get(), buffer.data(), buffer.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail(path, "read");
    if (got == 0) return bytes;
    bytes.append(buffer.data(), static_cast<std::size_t>(got));
    if (most > 0 && bytes.size() > most) throw config::Error(fmt::format("{} has more than {} bytes", path, most));
  }
}

}  // namespace iotcloud::processes
