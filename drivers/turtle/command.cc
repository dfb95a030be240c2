#include <cmath>

#include <nlohmann/json.hpp>

#include <iotcloud/drivers/turtle/command.h>

namespace iotcloud::drivers::turtle {

namespace {

constexpr std::size_t longest_command = 4096;  // bytes; a real one has some 100

std::optional<double> member(const nlohmann::json& command, const char* vector, const char* axis) {
  const auto outer = command.find(vector);
  if (outer == command.end() || !outer->is_object()) return std::nullopt;
  const auto inner = outer->find(axis);
  if (inner == outer->end() || !inner->is_number()) return std::nullopt;
  const double value = inner->get<double>();
  return std::isfinite(value) ? std::optional(value) : std::nullopt;
}

}  // namespace

std::optional<Velocity> parse_command(std::string_view text) noexcept {
  if (text.size() > longest_command) return std::nullopt;
  try {
    const auto command = nlohmann::json::parse(text, nullptr, false);
    if (!command.is_object()) return std::nullopt;
    const auto linear = member(command, "linear", "x");
    const auto angular = member(command, "angular", "z");
    if (!linear || !angular) return std::nullopt;
    return Velocity{*linear, *angular};
  } catch (...) {  // such as out of memory
    return std::nullopt;
  }
}

}  // namespace iotcloud::drivers::turtle
