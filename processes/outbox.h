#pragma once

#include <cstddef>
#include <string>

#include <iotcloud/processes/descriptor.h>

namespace iotcloud::processes {

/// Bytes that wait until a socket has room for them, in order. Two processes that each have more to say than a socket
/// holds must both read meanwhile, so neither may wait for room. Not thread safe.
class Outbox {
 public:
  void add(const std::string& bytes) { bytes_ += bytes; }
  std::size_t size() const { return bytes_.size() - sent_; }  ///< bytes that wait
  bool empty() const { return size() == 0; }
  void clear();
  /// Sends what the socket has room for now. \return false if the peer is gone.
  bool send(const OwnedDescriptor& socket);
  /// What waits; nothing does afterwards.
  std::string take();

 private:
  std::string bytes_;
  std::size_t sent_ = 0;  ///< how many of them were sent
};

}  // namespace iotcloud::processes
