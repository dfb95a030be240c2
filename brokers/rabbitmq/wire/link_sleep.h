#pragma once

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <stdexcept>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

namespace iotcloud::brokers::rabbitmq {

/// Where a connection's thread sleeps: in LinkSleep, or in a test's own, which goes by a clock that the test moves.
class ConnectionSleep {
 public:
  virtual ~ConnectionSleep() = default;
  /// Ends the present wait(), or else the next one. Thread safe.
  virtual void signal() noexcept = 0;
  /// Sets the socket that ends the next wait(); -1: none. A broken connection always ends it.
  virtual void watch(int socket, bool want_write) = 0;
  struct Result {
    bool readable = false;
    bool writable = false;
  };
  virtual Result wait(std::chrono::milliseconds limit) = 0;
};

/// Lets a link's thread sleep on its socket, while others can wake it at once, or set a later time without waking it.
class LinkSleep final : public ConnectionSleep {
 public:
  LinkSleep()
      : set_(::epoll_create1(EPOLL_CLOEXEC)),
        event_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        timer_(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK)) {
    if (set_ < 0 || event_ < 0 || timer_ < 0 || !change(EPOLL_CTL_ADD, event_, EPOLLIN) ||
        !change(EPOLL_CTL_ADD, timer_, EPOLLIN)) {
      close_all();
      throw std::runtime_error("cannot make a descriptor to sleep on: too many open files?");
    }
  }
  ~LinkSleep() override { close_all(); }
  LinkSleep(const LinkSleep&) = delete;
  LinkSleep& operator=(const LinkSleep&) = delete;

  void signal() noexcept override {
    const std::uint64_t one = 1;
    [[maybe_unused]] const auto written = ::write(event_, &one, sizeof(one));  // if it is full, it is signalled already
  }

  /// Calls of this and of put_off() must not overlap.
  void watch(int socket, bool want_write) override {
    if (socket_ >= 0 && socket_ != socket) change(EPOLL_CTL_MOD, socket_, 0);
    socket_ = socket;
    if (socket_ >= 0) listen(want_write ? EPOLLIN | EPOLLOUT : EPOLLIN);
  }
  /// For a sleeping thread: from now on the socket does not end its wait(), but the time does.
  void put_off(std::chrono::nanoseconds time) {
    if (socket_ >= 0) listen(0);
    signal_after(time);
  }
  /// Ends wait() after `time`; a later call replaces an earlier one. Thread safe. \param time less than a second
  void signal_after(std::chrono::nanoseconds time) {
    itimerspec once{};
    once.it_value.tv_nsec = std::max<std::int64_t>(time.count(), 1);  // 0 would stop the timer
    ::timerfd_settime(timer_, 0, &once, nullptr);
  }

  Result wait(std::chrono::milliseconds limit) override {
    std::array<epoll_event, 3> came{};
    const int count = ::epoll_wait(set_, came.data(), static_cast<int>(came.size()), static_cast<int>(limit.count()));
    Result result;
    for (int i = 0; i < count; ++i) {
      const epoll_event& one = came.at(static_cast<std::size_t>(i));
      if (one.data.fd == event_ || one.data.fd == timer_) {
        std::uint64_t times = 0;
        [[maybe_unused]] const auto got = ::read(one.data.fd, &times, sizeof(times));
      } else {
        result.readable = result.readable || (one.events & ~static_cast<std::uint32_t>(EPOLLOUT)) != 0;
        result.writable = result.writable || (one.events & EPOLLOUT) != 0;
      }
    }
    return result;
  }

 private:
  bool change(int operation, int descriptor, std::uint32_t events) {
    epoll_event wanted{};
    wanted.events = events;
    wanted.data.fd = descriptor;
    return ::epoll_ctl(set_, operation, descriptor, &wanted) == 0;
  }
  /// A closed socket leaves the set by itself, and a new one may have its number.
  void listen(std::uint32_t events) {
    if (!change(EPOLL_CTL_MOD, socket_, events) && errno == ENOENT) change(EPOLL_CTL_ADD, socket_, events);
  }
  void close_all() {
    for (const int descriptor : {set_, event_, timer_}) {
      if (descriptor >= 0) ::close(descriptor);
    }
  }

  const int set_;
  const int event_;
  const int timer_;
  int socket_ = -1;
};

}  // namespace iotcloud::brokers::rabbitmq
