#include "iotcloud/brokers/spool/store/disk.h"

#include <cerrno>

#include <unistd.h>

namespace iotcloud::brokers::spool {

int Disk::write(int descriptor, iovec* parts, int count, std::uint64_t offset) {
  while (count > 0) {
    const ssize_t written = ::pwritev(descriptor, parts, count, static_cast<off_t>(offset));
    if (written < 0) {
      if (errno == EINTR) continue;
      return errno;
    }
    offset += static_cast<std::uint64_t>(written);
    auto left = static_cast<std::size_t>(written);
    while (count > 0 && left >= parts->iov_len) {
      left -= parts->iov_len;
      ++parts;
      --count;
    }
    if (count > 0) {
      if (written == 0) return ENOSPC;
      parts->iov_base = static_cast<char*>(parts->iov_base) + left;
      parts->iov_len -= left;
    }
  }
  return 0;
}

int Disk::sync(int descriptor) {
  return ::fdatasync(descriptor) == 0 ? 0 : errno;
}

Disk& system_disk() {
  static Disk disk;
  return disk;
}

}  // namespace iotcloud::brokers::spool
