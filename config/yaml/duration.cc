#include <charconv>
#include <cmath>
#include <cstdint>
#include <string_view>

#include <iotcloud/config/yaml.h>
#include <iotcloud/config/yaml/duration.h>

namespace iotcloud::config {

std::optional<std::chrono::microseconds> parse_duration(const std::string& text) {
  double number = 0;
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (status != std::errc{} || !(number >= 0) || number > 1e12) return std::nullopt;
  const std::string_view unit(end, static_cast<std::size_t>(text.data() + text.size() - end));
  double factor = 0;
  if (unit == "us") factor = 1;
  if (unit == "ms") factor = 1e3;
  if (unit == "s") factor = 1e6;
  if (unit == "m") factor = 60e6;
  if (unit == "h") factor = 3600e6;
  if (factor == 0) return std::nullopt;
  return std::chrono::microseconds(std::llround(number * factor));
}

std::string internal::duration_text(std::chrono::microseconds time) {
  struct Unit {
    std::int64_t microseconds;
    const char* name;
  };
  constexpr Unit units[] = {{3'600'000'000, "h"}, {60'000'000, "m"}, {1'000'000, "s"}, {1000, "ms"}};
  if (time.count() == 0) return "0s";
  for (const Unit& unit : units) {
    if (time.count() % unit.microseconds == 0) return std::to_string(time.count() / unit.microseconds) + unit.name;
  }
  return std::to_string(time.count()) + "us";
}

}  // namespace iotcloud::config
