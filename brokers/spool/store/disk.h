#pragma once

#include <cstddef>
#include <cstdint>

#include <sys/uio.h>

namespace iotcloud::brokers::spool {

/// The writes of a spool, so that a test can let them fail. Thread safe.
class Disk {
 public:
  virtual ~Disk() = default;
  /// Writes everything at `offset` (the parts are used up). \return 0 or an errno; part of it may be written then.
  virtual int write(int descriptor, iovec* parts, int count, std::uint64_t offset);
  /// Returns when what was written is on the disk. \return 0 or an errno
  virtual int sync(int descriptor);
};

/// The real one.
Disk& system_disk();

}  // namespace iotcloud::brokers::spool
