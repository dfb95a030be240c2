#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>

namespace iotcloud::topology::internal {

/// A list of plain values that grows and keeps its memory, which a swap hands over. Unlike a vector it leaves memory
/// uninitialized, and its push() is short enough to be inlined into every emit. Not thread safe.
template <typename T>
class FlatList {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  FlatList() = default;
  FlatList(FlatList&& other) noexcept { swap(other); }
  FlatList& operator=(FlatList&&) = delete;

  T* begin() const { return memory_.get(); }
  T* end() const { return end_; }
  std::size_t size() const { return static_cast<std::size_t>(end_ - begin()); }
  bool empty() const { return end_ == begin(); }
  std::size_t capacity() const { return static_cast<std::size_t>(limit_ - begin()); }  ///< values that fit

  [[gnu::always_inline]] void push(const T& value) {
    if (end_ == limit_) [[unlikely]]
      reserve(std::max(least, 2 * capacity()));
    *end_++ = value;
  }
  bool has_room() const { return end_ != limit_; }  ///< push() takes no new memory
  void append(std::span<const T> values) {
    const std::size_t needed = size() + values.size();
    if (needed > capacity()) reserve(std::max(2 * capacity(), needed));
    end_ = std::copy(values.begin(), values.end(), end_);
  }
  void clear() { end_ = begin(); }
  /// Says how many values are in the memory, to which the caller has written. \pre at most capacity().
  void set_size(std::size_t size) { end_ = begin() + size; }
  [[gnu::noinline]] void reserve(std::size_t capacity) {
    if (capacity <= this->capacity()) return;
    const std::size_t count = size();
    std::unique_ptr<T[]> grown(new T[capacity]);
    std::copy(begin(), end(), grown.get());
    memory_ = std::move(grown);
    end_ = begin() + count;
    limit_ = begin() + capacity;
  }
  void swap(FlatList& other) noexcept {
    memory_.swap(other.memory_);
    std::swap(end_, other.end_);
    std::swap(limit_, other.limit_);
  }

 private:
  static constexpr std::size_t least = 16;
  std::unique_ptr<T[]> memory_;
  T* end_ = nullptr;
  T* limit_ = nullptr;
};

}  // namespace iotcloud::topology::internal
