#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include <iotcloud/brokers/message.h>

namespace iotcloud::bench {

/// A driver's message bodies, whose buffers are used again when no message holds them any more. Not thread safe, but
/// any thread may release a body.
class Bodies {
 public:
  explicit Bodies(std::size_t size) : size_(size) {}
  std::size_t size() const { return size_; }

  /// Makes a body that begins with these bytes, at most size() of them.
  brokers::Payload beginning_with(std::span<const std::byte> head) {
    std::shared_ptr<std::vector<std::byte>> free;
    for (std::size_t tried = 0; tried < buffers_.size() && !free; ++tried) {
      next_ = (next_ + 1) % buffers_.size();
      if (buffers_[next_].use_count() == 1) free = buffers_[next_];
    }
    if (!free) free = buffers_.emplace_back(std::make_shared<std::vector<std::byte>>(size_));
    std::atomic_thread_fence(std::memory_order_acquire);  // its last holder has finished reading
    std::copy(head.begin(), head.end(), free->begin());
    const std::span<const std::byte> bytes = *free;
    return brokers::Payload::wrap(std::move(free), bytes);
  }

 private:
  std::size_t size_;
  std::size_t next_ = 0;
  std::vector<std::shared_ptr<std::vector<std::byte>>> buffers_;
};

}  // namespace iotcloud::bench
