#include <cerrno>
#include <cstdint>
#include <cstring>

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/descriptor.h>

namespace iotcloud::processes {

void OwnedDescriptor::reset() {
  if (fd_ >= 0) close(std::exchange(fd_, -1));
}

bool wait_readable(int fd, std::chrono::milliseconds limit) {
  pollfd poll_on{fd, POLLIN, 0};
  return poll(&poll_on, 1, static_cast<int>(limit.count())) > 0;
}

Waker::Waker() : fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!fd_) throw config::Error(fmt::format("eventfd: {}", std::strerror(errno)));
}

void Waker::wake() noexcept {
  const std::uint64_t one = 1;
  static_cast<void>(!write(fd_.get(), &one, sizeof(one)));  // if the eventfd is full, the thread has been woken already
}

void Waker::clear() noexcept {
  std::uint64_t count = 0;
  static_cast<void>(!read(fd_.get(), &count, sizeof(count)));
}

}  // namespace iotcloud::processes
