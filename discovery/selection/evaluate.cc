#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <string_view>

#include <iotcloud/discovery/selection/lexer.h>
#include <iotcloud/discovery/selection/program.h>

namespace iotcloud::discovery {
namespace {

using Program = Selection::Program;
using Kind = Program::Kind;
using internal::to_number;

constexpr double earth_radius = 6'371'008.8;  ///< metres, mean (IUGG)
constexpr double radians = std::numbers::pi / 180;

const char* state_word(DriverState state) noexcept {
  switch (state) {
    case DriverState::deployed:
      return "deployed";
    case DriverState::starting:
      return "starting";
    case DriverState::active:
      return "active";
    case DriverState::stopping:
      return "stopping";
    case DriverState::inactive:
      return "inactive";
    case DriverState::failed:
      return "failed";
    case DriverState::undeployed:
      return "undeployed";
    case DriverState::ordered:
      return "ordered";
  }
  return "";
}

using Value = std::optional<std::string_view>;

Value metadata_of(const DriverRecord& driver, const std::string& key) noexcept {
  const auto found = driver.metadata.find(key);
  if (found == driver.metadata.end()) return std::nullopt;
  return found->second;
}

Value value_of(const DriverRecord& driver, const Program::Key& key) noexcept {
  switch (key.source) {
    case Program::Source::metadata:
      return metadata_of(driver, key.name);
    case Program::Source::driver:
      return driver.name.str();
    case Program::Source::gateway:
      return driver.gateway.str();
    case Program::Source::instance:
      return driver.instance.str();
    case Program::Source::state:
      return state_word(driver.state);
  }
  return std::nullopt;
}

template <typename Operand>
bool compare(Kind kind, const Operand& left, const Operand& right) noexcept {
  switch (kind) {
    case Kind::equal:
      return left == right;
    case Kind::not_equal:
      return left != right;
    case Kind::less:
      return left < right;
    case Kind::less_equal:
      return left <= right;
    case Kind::greater:
      return left > right;
    case Kind::greater_equal:
      return left >= right;
    default:
      return false;
  }
}

bool compare(Kind kind, std::string_view value, const Program::Literal& literal) noexcept {
  if (!literal.is_number) return compare<std::string_view>(kind, value, literal.text);
  double number = 0;
  if (to_number(value, number)) return compare<double>(kind, number, literal.number);
  // a value that is not a number differs from every number, and is neither less nor greater
  return kind == Kind::not_equal;
}

std::string_view trimmed(std::string_view text) noexcept {
  while (text.starts_with(' ')) text.remove_prefix(1);
  while (text.ends_with(' ')) text.remove_suffix(1);
  return text;
}

/// Reads two coordinates, from one key ("39.17,-86.52") or from two keys.
bool place_of(const DriverRecord& driver, const std::string& pair, const std::string& first_key,
              const std::string& second_key, double& first, double& second) noexcept {
  if (const Value both = metadata_of(driver, pair)) {
    const std::size_t comma = both->find(',');
    return comma != std::string_view::npos && to_number(trimmed(both->substr(0, comma)), first) &&
           to_number(trimmed(both->substr(comma + 1)), second);
  }
  const Value one = metadata_of(driver, first_key);
  const Value two = metadata_of(driver, second_key);
  return one && two && to_number(*one, first) && to_number(*two, second);
}

const std::string location_key = "location", latitude_key = "latitude", longitude_key = "longitude";
const std::string position_key = "position", x_key = "x", y_key = "y";

bool within_location(const DriverRecord& driver, const Program::Circle& circle) noexcept {
  double latitude = 0;
  double longitude = 0;
  if (!place_of(driver, location_key, latitude_key, longitude_key, latitude, longitude)) return false;
  if (std::abs(latitude) > 90 || std::abs(longitude) > 180) return false;
  latitude *= radians;
  if (std::abs(latitude - circle.first) * earth_radius > circle.radius * (1 + 1e-9)) return false;
  return internal::great_circle(latitude, longitude * radians, circle) <= circle.radius;
}

bool within_position(const DriverRecord& driver, const Program::Circle& circle) noexcept {
  double x = 0;
  double y = 0;
  if (!place_of(driver, position_key, x_key, y_key, x, y)) return false;
  return std::hypot(x - circle.first, y - circle.second) <= circle.radius;
}

bool condition_holds(const Program& program, const Program::Node& node, const DriverRecord& driver) noexcept {
  if (node.kind == Kind::within_location) return within_location(driver, program.circles[node.left]);
  if (node.kind == Kind::within_position) return within_position(driver, program.circles[node.left]);
  const Value value = value_of(driver, node.key);
  if (!value) return false;
  const auto* const first = program.literals.data() + node.left;
  const auto* const last = program.literals.data() + node.right;
  switch (node.kind) {
    case Kind::exists:
      return true;
    case Kind::in:
    case Kind::not_in: {
      const bool found = std::any_of(first, last, [&](const auto& one) { return compare(Kind::equal, *value, one); });
      return found == (node.kind == Kind::in);
    }
    case Kind::starts_with:
      return value->starts_with(first->text);
    case Kind::ends_with:
      return value->ends_with(first->text);
    case Kind::contains:
      return value->find(first->text) != std::string_view::npos;
    default:
      return compare(node.kind, *value, *first);
  }
}

/// Recurses as deep as parentheses are nested and chains of `and` or `or` are long: max_size bounds both.
bool node_holds(const Program& program, std::uint32_t index, const DriverRecord& driver) noexcept {
  const Program::Node& node = program.nodes[index];
  switch (node.kind) {
    case Kind::all_of:
      return node_holds(program, node.left, driver) && node_holds(program, node.right, driver);
    case Kind::any_of:
      return node_holds(program, node.left, driver) || node_holds(program, node.right, driver);
    case Kind::none_of:
      return !node_holds(program, node.left, driver);
    default:
      return condition_holds(program, node, driver);
  }
}

}  // namespace

double internal::great_circle(double latitude, double longitude, const Program::Circle& centre) noexcept {
  const double half_latitude = std::sin((latitude - centre.first) / 2);
  const double half_longitude = std::sin((longitude - centre.second) / 2);
  const double square =
      half_latitude * half_latitude + std::cos(latitude) * centre.cosine * half_longitude * half_longitude;
  return 2 * earth_radius * std::asin(std::min(1.0, std::sqrt(square)));
}

bool internal::holds(const Program& program, const DriverRecord& driver) noexcept {
  return node_holds(program, static_cast<std::uint32_t>(program.nodes.size() - 1), driver);
}

}  // namespace iotcloud::discovery
