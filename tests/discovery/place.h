#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery::tests {

/// Where a contract test's registry lives: an empty tree of its own, and the power to harm it.
class Place {
 public:
  virtual ~Place() = default;
  virtual std::string url() const = 0;
  /// The server is gone for all clients (killed, where there is a process), and back with its tree.
  virtual void stop() = 0;
  virtual void start() = 0;
  /// The server keeps its connections and answers nothing, and goes on.
  virtual void hang() = 0;
  virtual void go_on() = 0;
  /// The server drops a session; its client hears of it.
  virtual void expire(std::int64_t session) = 0;
};

/// \param kind "embedded" or "zookeeper" (one server for the whole test program, a chroot for each place).
std::unique_ptr<Place> make_place(const std::string& kind);

}  // namespace iotcloud::discovery::tests
