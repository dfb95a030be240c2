#pragma once

#include <cstddef>
#include <cstdint>

#include <sys/uio.h>

namespace iotcloud::brokers::spool {

/// The writes of a spool; a test can make them fail. Thread safe.
class Disk {
 public:
  virtual ~Disk() = default;
  /// Writes everything at `offset` (and changes `parts`). \return 0 or an errno, after which a part may be written.
  virtual int write(int descriptor, iovec* parts, int count, std::uint64_t offset);
  /// Syncs written data to the disk. \return 0 or an errno
  virtual int sync(int descriptor);
};

/// The real disk.
Disk& system_disk();

}  // namespace iotcloud::brokers::spool
