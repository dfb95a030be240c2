#pragma once

#include <algorithm>
#include <compare>
#include <cstddef>
#include <functional>
#include <ostream>
#include <string>
#include <string_view>
#include <utility>

#include <fmt/core.h>

namespace iotcloud::discovery {

/// Text that identifies one kind of thing; `Tag` says which kind. Ids of two kinds do not convert into each other, and
/// text becomes an id only by an explicit constructor call, so swapped arguments do not compile. An id converts to text
/// implicitly. This class does not check the text: the code that receives it from outside does.
template <typename Tag>
class Id {
 public:
  Id() = default;
  explicit Id(std::string text) : text_(std::move(text)) {}
  explicit Id(std::string_view text) : text_(text) {}
  explicit Id(const char* text) : text_(text) {}
  /// Ids of different kinds do not convert into each other, although both convert to text.
  template <typename Other>
  explicit Id(const Id<Other>&) = delete;

  const std::string& str() const& { return text_; }
  std::string str() && { return std::move(text_); }
  // NOLINTNEXTLINE(google-explicit-constructor): for paths, messages and logs, which take any text
  operator const std::string&() const { return text_; }
  bool empty() const { return text_.empty(); }

  friend bool operator==(const Id&, const Id&) = default;
  // clang-tidy 14 takes the zero that it compares with for a pointer: NOLINTNEXTLINE(modernize-use-nullptr)
  friend auto operator<=>(const Id&, const Id&) = default;
  friend bool operator==(const Id& id, std::string_view text) { return id.text_ == text; }
  friend auto operator<=>(const Id& id, std::string_view text) { return std::string_view(id.text_) <=> text; }

  friend std::string operator+(std::string_view text, const Id& id) { return std::string(text).append(id.text_); }
  friend std::string operator+(const Id& id, std::string_view text) { return std::string(id.text_).append(text); }
  friend std::ostream& operator<<(std::ostream& out, const Id& id) { return out << id.text_; }

 private:
  std::string text_;
};

using GatewayId = Id<struct GatewayTag>;
using InstanceId = Id<struct InstanceTag>;  ///< of a driver instance
using DriverName = Id<struct DriverTag>;    ///< of a kind of driver ("turtle"), which many instances have
using TopologyName = Id<struct TopologyTag>;
using PoolId = Id<struct PoolTag>;  ///< of a pool of topology workers

namespace detail {
template <typename Value>
inline constexpr bool is_id = false;
template <typename Tag>
inline constexpr bool is_id<Id<Tag>> = true;
}  // namespace detail

/// Any kind of id.
template <typename Value>
concept AnyId = detail::is_id<Value>;

}  // namespace iotcloud::discovery

/// With std::equal_to<> a hashed container finds an id by its text, too.
template <typename Tag>
struct std::hash<iotcloud::discovery::Id<Tag>> {
  using is_transparent = void;
  std::size_t operator()(const iotcloud::discovery::Id<Tag>& id) const noexcept {
    return (*this)(std::string_view(id.str()));
  }
  std::size_t operator()(std::string_view text) const noexcept { return std::hash<std::string_view>()(text); }
};

// Doxygen 1.9 does not find the scope of this specialization.
/// \cond
/// "{}" writes an id as its text.
template <typename Tag>
struct fmt::formatter<iotcloud::discovery::Id<Tag>> {
  constexpr auto parse(fmt::format_parse_context& context) { return context.begin(); }
  template <typename Context>
  auto format(const iotcloud::discovery::Id<Tag>& id, Context& context) const {
    return std::copy(id.str().begin(), id.str().end(), context.out());
  }
};
/// \endcond
