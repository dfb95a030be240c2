#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery::tests {

/// A contract test's registry: an empty tree of its own, and the means to harm it.
class Place {
 public:
  virtual ~Place() = default;
  virtual std::string url() const = 0;
  /// Makes the server unreachable for all clients (kills its process if it has one); start() brings it back with its
  /// tree.
  virtual void stop() = 0;
  virtual void start() = 0;
  /// Makes the server keep its connections but answer nothing, until go_on().
  virtual void hang() = 0;
  virtual void go_on() = 0;
  /// Makes the server drop a session, and tell its client so.
  virtual void expire(std::int64_t session) = 0;
};

/// \param kind "embedded" or "zookeeper" (one server for the whole test program, a chroot for each place).
std::unique_ptr<Place> make_place(const std::string& kind);

}  // namespace iotcloud::discovery::tests
