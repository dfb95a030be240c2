#pragma once

#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

namespace iotcloud::drivers {

/// A serial line whose other end is a terminal of the kernel: the device is the test.
class Line {
 public:
  Line() : device_(posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC)) {
    EXPECT_EQ(grantpt(device_), 0);
    EXPECT_EQ(unlockpt(device_), 0);
  }
  ~Line() { unplug(); }
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;

  std::string path() const { return ptsname(device_); }
  /// The device's end.
  int descriptor() const { return device_; }
  void write(const std::string& bytes) const {
    EXPECT_EQ(::write(device_, bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  }
  /// What the driver has sent, and comes within patience.
  std::string read(std::size_t size) const {
    std::string bytes;
    pollfd waiting{device_, POLLIN, 0};
    while (bytes.size() < size && poll(&waiting, 1, 60'000) == 1) {
      char buffer[256];
      const ssize_t count = ::read(device_, buffer, sizeof buffer);
      if (count <= 0) break;
      bytes.append(buffer, static_cast<std::size_t>(count));
    }
    return bytes;
  }
  termios settings() const {
    termios line{};
    EXPECT_EQ(tcgetattr(device_, &line), 0);
    return line;
  }
  void unplug() {
    if (device_ >= 0) ::close(device_);
    device_ = -1;
  }

 private:
  int device_;
};

}  // namespace iotcloud::drivers
