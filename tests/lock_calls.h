#pragma once

#include <functional>
#include <mutex>
#include <utility>

#include <sys/syscall.h>
#include <unistd.h>

/// Defines flock for the whole test program of which a source includes it.
namespace iotcloud::tests {

/// From construction to destruction, is told before the process locks a file. One at a time. Thread safe.
class LockCalls {
 public:
  /// \param before called on the thread that locks; it may block
  explicit LockCalls(std::function<void()> before) {
    const std::lock_guard lock(mutex());
    current() = std::move(before);
  }
  ~LockCalls() {
    const std::lock_guard lock(mutex());
    current() = nullptr;
  }
  LockCalls(const LockCalls&) = delete;
  LockCalls& operator=(const LockCalls&) = delete;

  static void called() {
    std::function<void()> before;
    {
      const std::lock_guard lock(mutex());
      before = current();
    }
    if (before) before();
  }

 private:
  static std::mutex& mutex() {
    static std::mutex one;
    return one;
  }
  static std::function<void()>& current() {
    static std::function<void()> one;
    return one;
  }
};

}  // namespace iotcloud::tests

extern "C" __attribute__((weak)) int flock(int descriptor, int operation) {
  iotcloud::tests::LockCalls::called();
  return static_cast<int>(syscall(SYS_flock, descriptor, operation));
}
