#include <cerrno>
#include <cstdio>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/access/private_file.h>
#include <iotcloud/config/error.h>

namespace iotcloud::config {

void write_new_file(const std::string& file, const std::string& text, unsigned permissions) {
  const int descriptor = open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, permissions);
  if (descriptor < 0) throw Error(fmt::format("{} cannot be made: {}", file, std::strerror(errno)));
  std::size_t written = 0;
  while (written < text.size()) {
    const auto more = write(descriptor, text.data() + written, text.size() - written);
    if (more < 0 && errno != EINTR) break;
    if (more > 0) written += static_cast<std::size_t>(more);
  }
  const bool done = written == text.size() && fsync(descriptor) == 0;
  const int problem = errno;
  close(descriptor);
  if (done) return;
  unlink(file.c_str());
  throw Error(fmt::format("{} cannot be written: {}", file, std::strerror(problem)));
}

void replace_private_file(const std::string& file, const std::string& text) {
  const std::string fresh = fmt::format("{}.new-{}", file, getpid());
  write_new_file(fresh, text, for_owner);
  // A daemon of another user that could read it still can.
  struct stat before {};
  if (stat(file.c_str(), &before) == 0 && (chown(fresh.c_str(), before.st_uid, before.st_gid) != 0 ||
                                           chmod(fresh.c_str(), before.st_mode & (S_IRWXU | S_IRGRP)) != 0)) {
    const int problem = errno;
    unlink(fresh.c_str());
    throw Error(fmt::format("{} cannot be given to the owner of {}: {}", fresh, file, std::strerror(problem)));
  }
  if (std::rename(fresh.c_str(), file.c_str()) == 0) return;
  const int problem = errno;
  unlink(fresh.c_str());
  throw Error(fmt::format("{} cannot be replaced: {}", file, std::strerror(problem)));
}

}  // namespace iotcloud::config
