#pragma once

#include <array>
#include <cerrno>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <sys/syscall.h>
#include <unistd.h>

/// Defines fsync and fdatasync for the whole test program of which a source includes it.
namespace iotcloud::tests {

/// From construction to destruction, what the process brings to the disk. One at a time. Thread safe.
class SyncCalls {
 public:
  /// What a call for this path returns: 0, or an error number. Called on the caller's thread, and may block.
  using Answer = std::function<int(const std::string& path)>;

  explicit SyncCalls(Answer answer = {}) : answer_(std::move(answer)) {
    const std::lock_guard lock(mutex());
    current() = this;
  }
  ~SyncCalls() {
    const std::lock_guard lock(mutex());
    current() = nullptr;
  }
  SyncCalls(const SyncCalls&) = delete;
  SyncCalls& operator=(const SyncCalls&) = delete;

  /// The files and folders in the order of the calls.
  std::vector<std::string> paths() const {
    const std::lock_guard lock(mutex());
    return paths_;
  }
  bool contains(std::string_view path) const {
    const std::lock_guard lock(mutex());
    for (const auto& one : paths_) {
      if (one == path) return true;
    }
    return false;
  }

  /// \return the error number of a call for this descriptor
  static int called(int descriptor) {
    std::array<char, 4096> path{};
    const auto size = readlink(fmt::format("/proc/self/fd/{}", descriptor).c_str(), path.data(), path.size());
    const std::string name(path.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
    Answer answer;
    {
      const std::lock_guard lock(mutex());
      if (current() == nullptr) return 0;
      current()->paths_.push_back(name);
      answer = current()->answer_;
    }
    return answer ? answer(name) : 0;
  }

 private:
  static std::mutex& mutex() {
    static std::mutex one;
    return one;
  }
  static SyncCalls*& current() {
    static SyncCalls* one = nullptr;
    return one;
  }

  const Answer answer_;
  std::vector<std::string> paths_;  ///< guarded by mutex()
};

}  // namespace iotcloud::tests

extern "C" __attribute__((weak)) int fsync(int descriptor) {
  const int problem = iotcloud::tests::SyncCalls::called(descriptor);
  errno = problem;
  return problem != 0 ? -1 : static_cast<int>(syscall(SYS_fsync, descriptor));
}

extern "C" __attribute__((weak)) int fdatasync(int descriptor) {
  const int problem = iotcloud::tests::SyncCalls::called(descriptor);
  errno = problem;
  return problem != 0 ? -1 : static_cast<int>(syscall(SYS_fdatasync, descriptor));
}
