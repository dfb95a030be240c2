#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <utility>

namespace iotcloud::gateway {

/// An open file descriptor, closed with its owner.
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

/// Sockets in a folder, whatever the length of its path (the address goes by way of the folder's descriptor).
/// \throws config::Error when it cannot listen.
OwnedDescriptor listen_in(const std::string& folder, const std::string& name);
/// An empty descriptor when nobody listens; errno says why.
OwnedDescriptor connect_in(const std::string& folder, const std::string& name);
/// The next connection; an empty descriptor when there is none after all.
OwnedDescriptor accept_from(const OwnedDescriptor& listener);
/// The process that listens at the other end of a connected socket; 0 when not known.
int peer_process(const OwnedDescriptor& socket);

/// Sends all, waiting at most two seconds for room. \return false when the peer is gone or does not take it.
bool send_all(const OwnedDescriptor& socket, const std::string& bytes);
/// What there is, at most 64 KB. \return nullopt at the end of the stream or on an error; empty when there is nothing.
std::optional<std::string> receive_some(const OwnedDescriptor& socket);
/// Waits until the descriptor is readable or hung up. \return false when `limit` passed first.
bool wait_readable(int fd, std::chrono::milliseconds limit);

/// Wakes a thread that polls: an eventfd.
class Waker {
 public:
  Waker();
  void wake() noexcept;
  void clear() noexcept;
  int get() const { return fd_.get(); }

 private:
  OwnedDescriptor fd_;
};

}  // namespace iotcloud::gateway
