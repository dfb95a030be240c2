#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

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
  Values() = default;
  /// `Values(payload, "turtle-1", 42)`: each argument becomes one Value.
  template <typename First, typename... Rest>
  requires(!std::is_same_v<std::decay_t<First>, Values>) explicit Values(First&& first, Rest&&... rest) {
    add(make(std::forward<First>(first)));
    (add(make(std::forward<Rest>(rest))), ...);
  }

  void add(Value value) {
    if (size_ < inline_capacity) {
      inline_[size_++] = std::move(value);
      return;
    }
    if (size_ == inline_capacity) {
      more_.reserve(2 * inline_capacity);
      for (auto& v : inline_) more_.push_back(std::move(v));
    }
    more_.push_back(std::move(value));
    ++size_;
  }
  std::size_t size() const { return size_; }
  const Value& operator[](std::size_t i) const { return all()[i]; }
  std::span<const Value> all() const {
    return size_ <= inline_capacity ? std::span<const Value>(inline_.data(), size_) : std::span<const Value>(more_);
  }

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
  std::array<Value, inline_capacity> inline_;
  std::vector<Value> more_;  ///< all of them, once there are more than fit inline
  std::size_t size_ = 0;
};

}  // namespace iotcloud::topology
