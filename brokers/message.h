#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace iotcloud::brokers {

/// Shared immutable bytes: copying a Payload shares them. Thread safe, like a shared_ptr to const.
class Payload {
 public:
  Payload() = default;

  /// Copies the bytes once.
  static Payload copy(std::span<const std::byte> bytes) {
    if (bytes.empty()) return {};
    std::shared_ptr<std::byte[]> owned(new std::byte[bytes.size()]);
    std::memcpy(owned.get(), bytes.data(), bytes.size());
    const std::byte* data = owned.get();
    return Payload(std::shared_ptr<const void>(std::move(owned), data), data, bytes.size());
  }
  static Payload copy(std::string_view text) { return copy(std::as_bytes(std::span(text.data(), text.size()))); }

  /// Takes a container over without copying its bytes.
  template <typename Container>
  static Payload take(Container&& container) {
    auto owned = std::make_shared<const std::decay_t<Container>>(std::forward<Container>(container));
    const auto bytes = std::as_bytes(std::span(owned->data(), owned->size()));
    return Payload(std::move(owned), bytes.data(), bytes.size());
  }

  /// Refers to `bytes`, which live as long as `owner` (a broker library's frame, say). No copy.
  static Payload wrap(std::shared_ptr<const void> owner, std::span<const std::byte> bytes) {
    return Payload(std::move(owner), bytes.data(), bytes.size());
  }

  // The bytes live as long as a Payload that shares them.
  const std::byte* data() const { return data_; }
  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  std::span<const std::byte> bytes() const { return {data_, size_}; }
  std::string_view text() const { return {reinterpret_cast<const char*>(data_), size_}; }
  /// Equal bytes.
  friend bool operator==(const Payload& a, const Payload& b) { return a.text() == b.text(); }

 private:
  Payload(std::shared_ptr<const void> owner, const std::byte* data, std::size_t size)
      : owner_(std::move(owner)), data_(data), size_(size) {}
  std::shared_ptr<const void> owner_;
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
};

/// The custom properties of a message: a small flat map, keys and values of any bytes, order kept.
class Properties {
 public:
  using Entry = std::pair<std::string, std::string>;
  /// Replaces the value of a key that is there.
  void set(std::string_view key, std::string_view value) {
    for (auto& [k, v] : entries_) {
      if (k == key) {
        v = value;
        return;
      }
    }
    entries_.emplace_back(key, value);
  }
  /// nullptr when there is no such key; the pointer dies with the next change.
  const std::string* find(std::string_view key) const {
    for (const auto& [k, v] : entries_) {
      if (k == key) return &v;
    }
    return nullptr;
  }
  auto begin() const { return entries_.begin(); }
  auto end() const { return entries_.end(); }
  std::size_t size() const { return entries_.size(); }
  bool empty() const { return entries_.empty(); }
  friend bool operator==(const Properties&, const Properties&) = default;

 private:
  std::vector<Entry> entries_;
};

/// The unit of transport: a payload and its metadata (docs/wire.md#message-metadata says how it travels).
struct Message {
  Payload payload;           ///< any bytes; 128 MiB at most (brokers/limits.h)
  std::string driver_id;     ///< id of the driver instance that sent it or is to get it
  std::string gateway_id;    ///< empty when not known
  std::int64_t time_ms = 0;  ///< milliseconds since 1970 UTC, set by the device's side and carried to the answer
  Properties properties;     ///< any others; names that docs/wire.md#message-metadata uses are not carried
};

}  // namespace iotcloud::brokers
