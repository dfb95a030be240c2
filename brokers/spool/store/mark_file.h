#pragma once

#include <cstdint>
#include <string>

#include "iotcloud/brokers/spool/store/disk.h"

namespace iotcloud::brokers::spool {

/// The low-water mark of a spool in a small file: every record below it is done with. Two places in the file are
/// written in turn, so that a write that does not come to its end leaves the other. Not thread safe.
class MarkFile {
 public:
  /// Opens or makes the file. \throws config::Error when it cannot.
  MarkFile(std::string path, Disk& disk);
  ~MarkFile();
  MarkFile(const MarkFile&) = delete;
  MarkFile& operator=(const MarkFile&) = delete;

  /// 0 when there is none yet.
  std::uint64_t mark() const { return mark_; }
  /// There was something in the file, and neither place is whole.
  bool damaged() const { return damaged_; }
  /// Writes a higher mark; a lower one is ignored. \return 0 or an errno: then it stands where it stood.
  int raise(std::uint64_t mark);
  int sync() { return disk_.sync(descriptor_); }
  const std::string& path() const { return path_; }

 private:
  const std::string path_;
  Disk& disk_;
  int descriptor_ = -1;
  std::uint64_t mark_ = 0;
  bool damaged_ = false;
  int next_place_ = 0;
};

}  // namespace iotcloud::brokers::spool
