#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>

#include <iotcloud/brokers/message.h>

namespace iotcloud::topology {

using brokers::Payload;

/// One field of a tuple. Payloads are shared, never copied.
using Value = std::variant<std::monostate, bool, std::int64_t, double, std::string, Payload>;

/// "null", "bool", "int", "double", "string" or "payload", for messages.
const char* kind_of(const Value& value);

/// A hash of a value that is the same in every process, build and version: 64-bit FNV-1a over a byte for the kind and
/// the value's canonical bytes (integers and doubles as 8 bytes little endian, -0.0 as 0.0; strings and payloads as
/// they are).
std::uint64_t stable_hash(const Value& value, std::uint64_t seed = 14695981039346656037ULL);

/// The values of a tuple, in the order of its fields. Up to four are held without an allocation.
class Values {
 public:
  Values() noexcept = default;
  /// `Values(payload, "turtle-1", 42)`: each argument becomes one Value.
  template <typename First, typename... Rest>
  requires(!std::is_same_v<std::decay_t<First>, Values>) explicit Values(First&& first, Rest&&... rest) {
    reserve(1 + sizeof...(Rest));
    new (data_ + size_++) Value(make(std::forward<First>(first)));
    (new (data_ + size_++) Value(make(std::forward<Rest>(rest))), ...);
  }
  Values(const Values& other) {
    reserve(other.size_);
    for (const Value& value : other.all()) add(value);
  }
  Values(Values&& other) noexcept { take(other); }
  Values& operator=(const Values& other) {
    if (this != &other) *this = Values(other);
    return *this;
  }
  Values& operator=(Values&& other) noexcept {
    if (this != &other) {
      clear();
      take(other);
    }
    return *this;
  }
  ~Values() { clear(); }

  void add(Value value) {
    if (size_ == capacity_) reserve(2 * capacity_);
    new (data_ + size_++) Value(std::move(value));
  }
  void clear() noexcept {
    std::destroy_n(data_, size_);
    if (capacity_ > inline_capacity) std::allocator<Value>().deallocate(data_, capacity_);
    data_ = inline_data();
    size_ = 0;
    capacity_ = inline_capacity;
  }
  std::size_t size() const { return size_; }
  const Value& operator[](std::size_t i) const { return data_[i]; }
  std::span<const Value> all() const { return {data_, size_}; }

 private:
  static constexpr std::size_t inline_capacity = 4;

  template <typename T>
  static Value make(T&& value) {
    using Plain = std::decay_t<T>;
    if constexpr (std::is_same_v<Plain, Value> || std::is_same_v<Plain, bool> ||
                  std::is_same_v<Plain, std::monostate> || std::is_same_v<Plain, Payload>) {
      return Value(std::forward<T>(value));
    } else if constexpr (std::is_integral_v<Plain> || std::is_enum_v<Plain>) {
      return Value(static_cast<std::int64_t>(value));
    } else if constexpr (std::is_floating_point_v<Plain>) {
      return Value(static_cast<double>(value));
    } else {
      return Value(std::string(std::forward<T>(value)));
    }
  }
  Value* inline_data() { return reinterpret_cast<Value*>(inline_); }
  void reserve(std::size_t capacity) {
    if (capacity <= capacity_) return;
    Value* grown = std::allocator<Value>().allocate(capacity);
    std::uninitialized_move_n(data_, size_, grown);
    const std::size_t size = size_;
    clear();
    data_ = grown;
    size_ = size;
    capacity_ = capacity;
  }
  /// \pre this one is empty.
  void take(Values& other) noexcept {
    if (other.capacity_ > inline_capacity) {
      data_ = std::exchange(other.data_, other.inline_data());
      capacity_ = std::exchange(other.capacity_, inline_capacity);
      size_ = std::exchange(other.size_, 0);
    } else {
      std::uninitialized_move_n(other.data_, other.size_, data_);
      size_ = other.size_;
      other.clear();
    }
  }

  alignas(Value) std::byte inline_[inline_capacity * sizeof(Value)];
  Value* data_ = inline_data();
  std::size_t size_ = 0;
  std::size_t capacity_ = inline_capacity;
};

}  // namespace iotcloud::topology
