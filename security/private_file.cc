#include <cerrno>
#include <cstring>

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/private_file.h>

namespace iotcloud::security {

void replace_private_file(const std::string& file, const std::string& text) {
  config::Replacement next(file, text, for_owner);
  // Keeps owner and mode, so that a daemon of another user can still read the file.
  struct stat before {};
  if (stat(file.c_str(), &before) == 0 && (chown(next.path().c_str(), before.st_uid, before.st_gid) != 0 ||
                                           chmod(next.path().c_str(), before.st_mode & (S_IRWXU | S_IRGRP)) != 0)) {
    throw config::Error(
        fmt::format("{} cannot be given to the owner of {}: {}", next.path(), file, std::strerror(errno)));
  }
  next.replace();
}

}  // namespace iotcloud::security
