#pragma once

#include <cstdint>
#include <string>

#include "iotcloud/brokers/spool/store/disk.h"

namespace iotcloud::brokers::spool {

/// The low-water mark of a spool in a small file: every record below it is finished. The file has two places, written
/// in turn, so that an interrupted write leaves the other intact. Not thread safe.
class MarkFile {
 public:
  /// Opens or makes the file. \throws config::Error if it cannot.
  MarkFile(std::string path, Disk& disk);
  ~MarkFile();
  MarkFile(const MarkFile&) = delete;
  MarkFile& operator=(const MarkFile&) = delete;

  /// 0 if there is no mark yet.
  std::uint64_t mark() const { return mark_; }
  /// The file was not empty, but neither place is intact.
  bool damaged() const { return damaged_; }
  /// Writes a higher mark; ignores a lower one. \return 0 or an errno, after which the mark is unchanged.
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
