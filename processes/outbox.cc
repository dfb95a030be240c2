#include <cerrno>
#include <utility>

#include <sys/socket.h>

#include <iotcloud/processes/outbox.h>

namespace iotcloud::processes {

namespace {

constexpr std::size_t most_sent_bytes = 1u << 20;  ///< that are kept in memory although they were sent

}  // namespace

void Outbox::clear() {
  bytes_.clear();
  sent_ = 0;
}

bool Outbox::send(const OwnedDescriptor& socket) {
  while (!empty()) {
    const ssize_t n = ::send(socket.get(), bytes_.data() + sent_, size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0 && errno == EAGAIN) break;
    if (n <= 0) return false;
    sent_ += static_cast<std::size_t>(n);
  }
  if (empty()) {
    clear();
  } else if (sent_ > most_sent_bytes) {
    bytes_.erase(0, std::exchange(sent_, 0));
  }
  return true;
}

std::string Outbox::take() {
  std::string rest = bytes_.substr(sent_);
  clear();
  return rest;
}

}  // namespace iotcloud::processes
