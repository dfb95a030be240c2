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

/// One field of a tuple. Copies of a value share a payload's bytes.
using Value = std::variant<std::monostate, bool, std::int64_t, double, std::string, Payload>;

/// "null", "bool", "int", "double", "string" or "payload", for error messages.
const char* kind_of(const Value& value);

/// A hash of a value that is the same in every process, build and version: 64-bit FNV-1a over a byte for the kind and
/// the value's canonical bytes (integers and doubles as 8 bytes little endian, -0.0 as 0.0; strings and payloads
/// unchanged).
std::uint64_t stable_hash(const Value& value, std::uint64_t seed = 14695981039346656037ULL);

/// The values of a tuple, in the order of its fields. Up to four are stored in the object itself, without an
/// allocation.
class Values {
 public:
  Values() noexcept = default;
  /// `Values(payload, "turtle-1", 42)`: each argument becomes one Value.
  template <typename First, typename... Rest>
  requires(!std::is_same_v<std::decay_t<First>, Values>) explicit Values(First&& first, Rest&&... rest) {
    reserve(1 + sizeof...(Rest));
    append(std::forward<First>(first));
    (append(std::forward<Rest>(rest)), ...);
  }
  Values(const Values& other) {
    reserve(other.size_);
    for (const Value& value : other.all()) append(value);
  }
  Values(Values&& other) noexcept { take(other); }
  Values& operator=(const Values& other) {
    if (this != &other) *this = Values(other);
    return *this;
  }
  [[gnu::always_inline]] Values& operator=(Values&& other) noexcept {
    if (this != &other) {
      clear();
      take(other);
    }
    return *this;
  }
  /// As an assignment of std::move(other), but \pre this object is empty.
  [[gnu::always_inline]] void fill(Values& other) noexcept { take(other); }
  ~Values() { clear(); }

  void add(Value value) {
    if (size_ == capacity_) reserve(std::size_t{2} * capacity_);
    append(std::move(value));
  }
  [[gnu::always_inline]] void clear() noexcept {
    for (Value *value = data_, *const end = data_ + size_; value != end; ++value) {
      if (!is_plain(*value)) destroy(*value);
    }
    size_ = 0;
    if (capacity_ > inline_capacity) free_grown();
  }
  std::size_t size() const { return size_; }
  const Value& operator[](std::size_t i) const { return data_[i]; }
  std::span<const Value> all() const { return {data_, size_}; }

 private:
  static constexpr std::uint32_t inline_capacity = 4;

  /// \pre size_ < capacity_.
  template <typename T>
  void append(T&& value) {
    using Plain = std::decay_t<T>;
    Value* const to = data_ + size_;
    if constexpr (std::is_same_v<Plain, Value>) {
      if (auto* payload = std::get_if<Payload>(&value)) {
        if constexpr (std::is_lvalue_reference_v<T>) {
          new (to) Value(std::in_place_type<Payload>, *payload);
        } else {
          new (to) Value(std::in_place_type<Payload>, std::move(*payload));
        }
      } else if (!copy_plain(value, to)) {
        new (to) Value(std::forward<T>(value));
      }
    } else if constexpr (std::is_same_v<Plain, bool> || std::is_same_v<Plain, std::monostate> ||
                         std::is_same_v<Plain, Payload>) {
      new (to) Value(std::forward<T>(value));
    } else if constexpr (std::is_integral_v<Plain> || std::is_enum_v<Plain>) {
      new (to) Value(static_cast<std::int64_t>(value));
    } else if constexpr (std::is_floating_point_v<Plain>) {
      new (to) Value(static_cast<double>(value));
    } else {
      new (to) Value(std::in_place_type<std::string>, std::forward<T>(value));
    }
    ++size_;
  }
  /// True if a value needs no destructor and can be moved by copying its bytes.
  static bool is_plain(const Value& value) { return value.index() <= 3; }
  static_assert(std::is_same_v<std::variant_alternative_t<3, Value>, double>);
  [[gnu::always_inline]] static void destroy(Value& value) noexcept {
    if (auto* text = std::get_if<std::string>(&value)) {
      std::destroy_at(text);
    } else if (auto* payload = std::get_if<Payload>(&value)) {
      destroy_payload(*payload);
    } else {
      destroy_other(value);
    }
  }
  [[gnu::noinline]] static void destroy_payload(Payload& payload) noexcept { std::destroy_at(&payload); }
  [[gnu::noinline]] static void destroy_other(Value& value) noexcept { value.~Value(); }

  /// Copies a plain value without the table of functions that std::variant's own copy uses; most values are plain, and
  /// most of these are numbers. \return false, and does nothing, if the value is not plain. \param to raw memory.
  [[gnu::always_inline]] static bool copy_plain(const Value& from, Value* to) noexcept {
    if (const std::int64_t* number = std::get_if<2>(&from)) {
      new (to) Value(*number);
      return true;
    }
    return copy_other_plain(from, to);
  }
  [[gnu::noinline]] static bool copy_other_plain(const Value& from, Value* to) noexcept {
    switch (from.index()) {
      case 0:
        new (to) Value;
        return true;
      case 1:
        new (to) Value(*std::get_if<1>(&from));
        return true;
      case 3:
        new (to) Value(*std::get_if<3>(&from));
        return true;
      default:
        return false;
    }
  }
  /// Moves a value to raw memory, and destroys the old one.
  [[gnu::always_inline]] static void relocate(Value* from, Value* to) noexcept {
    if (const std::int64_t* number = std::get_if<2>(from)) {  // first, because it is the most frequent
      new (to) Value(*number);
    } else if (auto* text = std::get_if<std::string>(from)) {
      relocate_text(*text, to);
    } else if (auto* payload = std::get_if<Payload>(from)) {
      new (to) Value(std::in_place_type<Payload>, std::move(*payload));
      std::destroy_at(payload);
    } else {
      relocate_other(from, to);
    }
  }
  [[gnu::noinline]] static void relocate_text(std::string& text, Value* to) noexcept {
    new (to) Value(std::in_place_type<std::string>, std::move(text));
    std::destroy_at(&text);
  }
  [[gnu::noinline]] static void relocate_other(Value* from, Value* to) noexcept {
    if (copy_other_plain(*from, to)) return;
    new (to) Value(std::move(*from));
    from->~Value();
  }
  Value* inline_data() { return reinterpret_cast<Value*>(inline_); }
  [[gnu::noinline]] void free_grown() noexcept {
    std::allocator<Value>().deallocate(data_, capacity_);
    data_ = inline_data();
    capacity_ = inline_capacity;
  }
  void reserve(std::size_t capacity) {
    if (capacity > capacity_) grow(capacity);
  }
  [[gnu::noinline]] void grow(std::size_t capacity) {
    Value* grown = std::allocator<Value>().allocate(capacity);
    for (std::uint32_t i = 0; i < size_; ++i) relocate(data_ + i, grown + i);
    if (capacity_ > inline_capacity) free_grown();
    data_ = grown;
    capacity_ = static_cast<std::uint32_t>(capacity);
  }
  /// \pre this object is empty.
  [[gnu::always_inline]] void take(Values& other) noexcept {
    const std::uint32_t size = std::exchange(other.size_, 0);
    size_ = size;
    if (other.capacity_ > inline_capacity) [[unlikely]] {
      data_ = std::exchange(other.data_, other.inline_data());
      capacity_ = std::exchange(other.capacity_, inline_capacity);
    } else {
      // The object itself has the values of both, as neither has grown.
      for (std::uint32_t i = 0; i < size; ++i) relocate(other.inline_data() + i, inline_data() + i);
    }
  }

  Value* data_ = inline_data();
  std::uint32_t size_ = 0;
  std::uint32_t capacity_ = inline_capacity;
  alignas(Value) std::byte inline_[inline_capacity * sizeof(Value)];
};

}  // namespace iotcloud::topology
