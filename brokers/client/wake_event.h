#pragma once

#include <chrono>
#include <cstdint>
#include <stdexcept>

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

namespace iotcloud::brokers::client {

/// Lets a thread sleep on a socket while others can wake it. Any thread may call signal(); one thread calls wait() and
/// clear().
class WakeEvent {
 public:
  WakeEvent() : event_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (event_ < 0) throw std::runtime_error("cannot make an eventfd: too many open files?");
  }
  ~WakeEvent() { ::close(event_); }
  WakeEvent(const WakeEvent&) = delete;
  WakeEvent& operator=(const WakeEvent&) = delete;

  /// For a library that signals by itself, by writing a number above 0 in eight bytes.
  int descriptor() const { return event_; }

  void signal() {
    const std::uint64_t one = 1;
    [[maybe_unused]] const auto written = ::write(event_, &one, sizeof(one));  // if it is full, it is signalled already
  }

  /// Resets the signal.
  void clear() {
    std::uint64_t count = 0;
    [[maybe_unused]] const auto got = ::read(event_, &count, sizeof(count));
  }

  struct Result {
    bool readable = false;
    bool writable = false;
  };
  /// Sleeps until the socket (-1: none) is readable, or writable if asked for, until a signal, or until the limit.
  Result wait(int socket, bool want_write, std::chrono::milliseconds limit) {
    const auto events = static_cast<short>(want_write ? POLLIN | POLLOUT : POLLIN);
    pollfd waiting[2] = {{event_, POLLIN, 0}, {socket, events, 0}};
    if (::poll(waiting, socket < 0 ? 1 : 2, static_cast<int>(limit.count())) <= 0) return {};
    if (waiting[0].revents != 0) clear();
    return {(waiting[1].revents & ~POLLOUT) != 0, (waiting[1].revents & POLLOUT) != 0};
  }

 private:
  int event_;
};

}  // namespace iotcloud::brokers::client
