#pragma once

#include <chrono>
#include <utility>

namespace iotcloud::processes {

/// An open file descriptor, closed by the destructor.
class OwnedDescriptor {
 public:
  OwnedDescriptor() = default;
  explicit OwnedDescriptor(int fd) : fd_(fd) {}
  OwnedDescriptor(OwnedDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  OwnedDescriptor& operator=(OwnedDescriptor&& other) noexcept {
    if (this != &other) {
      reset();
      fd_ = std::exchange(other.fd_, -1);
    }
    return *this;
  }
  ~OwnedDescriptor() { reset(); }
  void reset();
  int get() const { return fd_; }
  int release() { return std::exchange(fd_, -1); }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

/// Waits until the descriptor is readable or hung up. \return false if `limit` passed first.
bool wait_readable(int fd, std::chrono::milliseconds limit);

/// An eventfd that wakes a polling thread. Thread safe.
class Waker {
 public:
  /// \throws config::Error when no descriptor is left.
  Waker();
  void wake() noexcept;
  void clear() noexcept;
  int get() const { return fd_.get(); }

 private:
  OwnedDescriptor fd_;
};

}  // namespace iotcloud::processes
