#pragma once

#include <charconv>
#include <concepts>
#include <optional>
#include <string_view>
#include <system_error>

namespace iotcloud::config {

/// Reads a number as std::from_chars() does: no '+', no spaces, the same in every locale.
/// \param base of a whole number's digits, 2 to 36. \return nullopt unless the whole text is one number that the type
/// can hold.
template <std::integral Number>
std::optional<Number> parse_number(std::string_view text, int base = 10) noexcept {
  Number number = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, status] = std::from_chars(text.data(), end, number, base);
  if (status != std::errc{} || stop != end) return std::nullopt;
  return number;
}

template <std::floating_point Number>
std::optional<Number> parse_number(std::string_view text) noexcept {
  Number number = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, status] = std::from_chars(text.data(), end, number);
  if (status != std::errc{} || stop != end) return std::nullopt;
  return number;
}

}  // namespace iotcloud::config
