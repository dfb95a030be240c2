#pragma once

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <stdlib.h>

#include "iotcloud/brokers/spool/store/disk.h"
#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers::spool {

/// A disk that can be full or stand still, and counts its syncs. Thread safe.
class TestDisk : public Disk {
 public:
  int write(int descriptor, iovec* parts, int count, std::uint64_t offset) override {
    if (error != 0) {
      // Writes only a part, like a disk that becomes full during the write.
      if (parts->iov_len > 1) {
        iovec half{parts->iov_base, parts->iov_len / 2};
        Disk::write(descriptor, &half, 1, offset);
      }
      return error;
    }
    return Disk::write(descriptor, parts, count, offset);
  }
  int sync(int descriptor) override {
    ++syncs;
    stands_still.wait(true);
    return sync_error != 0 ? sync_error.load() : Disk::sync(descriptor);
  }
  std::atomic<int> error{0};  ///< errno of writes; 0: they succeed
  std::atomic<int> sync_error{0};
  std::atomic<int> syncs{0};
  std::atomic<bool> stands_still{false};  ///< no sync() returns; see StandStill
};

/// While this object exists, no sync() of the disk returns. It must be destroyed before the publisher.
class StandStill {
 public:
  explicit StandStill(TestDisk& disk) : disk_(disk) { disk_.stands_still = true; }
  ~StandStill() { end(); }
  StandStill(const StandStill&) = delete;
  StandStill& operator=(const StandStill&) = delete;
  void end() {
    disk_.stands_still = false;
    disk_.stands_still.notify_all();
  }

 private:
  TestDisk& disk_;
};

inline Message sample(const std::string& body, const std::string& driver = "d1") {
  Message message;
  message.payload = Payload::copy(body);
  message.driver_id = driver;
  message.time_ms = 17;
  return message;
}

/// The files with this ending, sorted.
inline std::vector<std::string> files(const std::string& folder, const std::string& ending) {
  std::vector<std::string> found;
  if (!std::filesystem::exists(folder)) return found;
  for (const auto& file : std::filesystem::directory_iterator(folder)) {
    if (file.path().string().ends_with(ending)) found.push_back(file.path().string());
  }
  std::sort(found.begin(), found.end());
  return found;
}

inline std::string read_all(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

inline void write_all(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

}  // namespace iotcloud::brokers::spool
