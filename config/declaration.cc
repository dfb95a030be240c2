#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>

namespace iotcloud::config {

namespace {

using Json = nlohmann::ordered_json;

// The marks are those of drivers/declaration.h and drivers/plugin.h, which this room does not know.
constexpr std::string_view declaration_mark = "iotcloud-plugin: declaration=";
constexpr std::string_view card_mark = "iotcloud-plugin: driver=";
constexpr std::string_view sdk_mark = "iotcloud-plugin: driver-sdk=";
constexpr std::size_t longest = std::size_t{64} * 1024;  // of a declaration, in bytes
constexpr std::size_t most_properties = 500;
constexpr int most_marks = 100;  // that are looked at: each may cost reading `longest` bytes

/// The first JSON object that stands behind the mark; a null value: there is none.
Json object_behind(std::string_view bytes, std::string_view mark) {
  auto at = bytes.find(mark);
  for (int marks = 0; at != std::string_view::npos && marks < most_marks; at = bytes.find(mark, at + 1), ++marks) {
    const auto rest = bytes.substr(at + mark.size(), longest);
    const auto end = rest.find('\0');
    if (end == std::string_view::npos || !rest.starts_with('{')) continue;
    auto json = Json::parse(rest.substr(0, end), nullptr, false);
    if (json.is_object()) return json;
  }
  return {};
}

std::string text_at(const Json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
}

std::optional<double> number_at(const Json& json, const char* key) {
  const auto found = json.find(key);
  if (found == json.end() || !found->is_number()) return std::nullopt;
  return found->get<double>();
}

bool is_type(const std::string& word) {
  return word == "text" || word == "number" || word == "integer" || word == "flag";
}

std::optional<DeclaredProperty> property_of(const Json& json) {
  if (!json.is_object()) return std::nullopt;
  DeclaredProperty property;
  property.name = text_at(json, "name");
  property.type = text_at(json, "type");
  if (property.name.empty() || !is_type(property.type)) return std::nullopt;
  property.unit = text_at(json, "unit");
  property.min = number_at(json, "min");
  property.max = number_at(json, "max");
  if (json.contains("default")) property.default_value = text_at(json, "default");
  property.required = json.contains("required") && json["required"] == true;
  property.text = text_at(json, "text");
  if (const auto choices = json.find("choices"); choices != json.end() && choices->is_array()) {
    for (const auto& choice : *choices) {
      if (choice.is_string()) property.choices.push_back(choice.get<std::string>());
    }
  }
  return property;
}

void fill(DriverDeclaration& declaration, const Json& json) {
  if (!json.is_object()) return;
  declaration.description = text_at(json, "description");
  const auto properties = json.find("properties");
  if (properties == json.end() || !properties->is_array() || properties->size() > most_properties) return;
  auto& declared = declaration.properties.emplace();
  for (const auto& each : *properties) {
    if (auto property = property_of(each)) declared.push_back(std::move(*property));
  }
}

Json json_of(const DeclaredProperty& property) {
  Json json{{"name", property.name}, {"type", property.type}};
  if (!property.unit.empty()) json["unit"] = property.unit;
  if (property.min) json["min"] = *property.min;
  if (property.max) json["max"] = *property.max;
  if (property.default_value) json["default"] = *property.default_value;
  if (property.required) json["required"] = true;
  if (!property.choices.empty()) json["choices"] = property.choices;
  if (!property.text.empty()) json["text"] = property.text;
  return json;
}

std::uint32_t sdk_version_in(std::string_view bytes) {
  for (auto at = bytes.find(sdk_mark); at != std::string_view::npos; at = bytes.find(sdk_mark, at + 1)) {
    const auto rest = bytes.substr(at + sdk_mark.size());
    std::uint32_t version = 0;
    const auto [end, status] = std::from_chars(rest.data(), rest.data() + rest.size(), version);
    if (status == std::errc{} && end != rest.data() + rest.size() && *end == ';') return version;
  }
  return 0;
}

std::optional<double> number_in(const std::string& value) {
  const auto number = parse_number<double>(value);
  return number && std::isfinite(*number) ? number : std::nullopt;
}

bool is_whole(const std::string& value) {
  return parse_number<std::int64_t>(value).has_value();
}

bool fits(const std::string& value, const DeclaredProperty& property) {
  if (property.type == "flag") return value == "true" || value == "false";
  if (property.type == "text") {
    return property.choices.empty() ||
           std::find(property.choices.begin(), property.choices.end(), value) != property.choices.end();
  }
  const auto number = number_in(value);
  return number && (property.type == "number" || is_whole(value)) && (!property.min || *number >= *property.min) &&
         (!property.max || *number <= *property.max);
}

const DeclaredProperty* find(const std::vector<DeclaredProperty>& properties, const std::string& name) {
  const auto found =
      std::find_if(properties.begin(), properties.end(), [&](const auto& property) { return property.name == name; });
  return found == properties.end() ? nullptr : &*found;
}

std::string unknown_text(const std::string& name, const std::vector<DeclaredProperty>& declared) {
  std::vector<std::string> names;
  names.reserve(declared.size());
  for (const auto& property : declared) names.push_back(property.name);
  const std::size_t own = names.size();
  names.insert(names.end(), host_properties().begin(), host_properties().end());
  if (const auto near = nearest(name, names); !near.empty())
    return fmt::format("unknown property; did you mean \"{}\"?", near);
  names.resize(own);
  if (names.empty()) return "unknown property; this driver has none";
  return fmt::format("unknown property; this driver has {}", fmt::join(names, ", "));
}

}  // namespace

std::string DeclaredProperty::values() const {
  if (type == "flag") return "true or false";
  if (!choices.empty()) return fmt::format("one of {}", fmt::join(choices, ", "));
  if (type == "text") return "any text";
  std::string words = type == "integer" ? "a whole number" : "a number";
  if (min && max) return fmt::format("{} from {} to {}", words, *min, *max);
  if (min) return fmt::format("{} from {} on", words, *min);
  if (max) return fmt::format("{} up to {}", words, *max);
  return words;
}

DriverDeclaration declaration_in(std::string_view bytes) {
  DriverDeclaration declaration;
  if (const auto card = object_behind(bytes, card_mark); card.is_object()) {
    declaration.driver = text_at(card, "name");
    declaration.version = text_at(card, "version");
  }
  declaration.sdk_version = sdk_version_in(bytes);
  fill(declaration, object_behind(bytes, declaration_mark));
  return declaration;
}

DriverDeclaration declaration_of(const char* json) {
  DriverDeclaration declaration;
  if (json != nullptr) fill(declaration, Json::parse(json, nullptr, false));
  return declaration;
}

std::string to_json(const DriverDeclaration& declaration) {
  Json json{{"driver", declaration.driver},
            {"version", declaration.version},
            {"sdk_version", declaration.sdk_version},
            {"description", declaration.description}};
  if (declaration.properties) {
    json["properties"] = Json::array();
    for (const auto& property : *declaration.properties) json["properties"].push_back(json_of(property));
  }
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

DriverDeclaration parse_declaration(std::string_view text) {
  DriverDeclaration declaration;
  const auto json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return declaration;
  declaration.driver = text_at(json, "driver");
  declaration.version = text_at(json, "version");
  if (const auto version = json.find("sdk_version"); version != json.end() && version->is_number_unsigned())
    declaration.sdk_version = version->get<std::uint32_t>();
  fill(declaration, json);
  return declaration;
}

std::vector<PropertyProblem> problems_of(const Properties& properties, const DriverDeclaration& declaration) {
  std::vector<PropertyProblem> problems;
  if (!declaration.properties) return problems;
  const auto& declared = *declaration.properties;
  for (const auto& [name, value] : properties) {
    const auto* property = find(declared, name);
    if (property == nullptr) {
      if (!is_host_property(name)) problems.push_back({name, unknown_text(name, declared)});
    } else if (!fits(value, *property)) {
      const std::string unit = property->unit.empty() ? "" : fmt::format(" ({})", property->unit);
      problems.push_back({name, fmt::format("\"{}\"; it takes {}{}", value, property->values(), unit)});
    }
  }
  for (const auto& property : declared) {
    if (!property.required || properties.contains(property.name)) continue;
    const std::string what = property.text.empty() ? "" : fmt::format(" ({})", property.text);
    problems.push_back({property.name, fmt::format("missing; it takes {}{}", property.values(), what)});
  }
  return problems;
}

std::string text_of(const std::vector<PropertyProblem>& problems) {
  std::string text;
  for (const auto& problem : problems)
    text += fmt::format("{}property \"{}\": {}", text.empty() ? "" : "; ", problem.property, problem.text);
  return text;
}

Properties with_defaults(Properties properties, const DriverDeclaration& declaration) {
  if (!declaration.properties) return properties;
  for (const auto& property : *declaration.properties) {
    if (property.default_value) properties.emplace(property.name, *property.default_value);
  }
  return properties;
}

Properties numbered(const Properties& properties, int index) {
  Properties with_mark;
  for (const auto& [name, value] : properties) {
    if (value.find(index_mark) == std::string::npos) continue;
    std::string text = value;
    for (auto at = text.find(index_mark); at != std::string::npos; at = text.find(index_mark, at))
      text.replace(at, index_mark.size(), std::to_string(index));
    with_mark[name] = std::move(text);
  }
  return with_mark;
}

const std::vector<std::string>& host_properties() {
  static const std::vector<std::string> names{"thread", "hang_limit", "isolation", "network", "on_partition", "lease"};
  return names;
}

bool is_host_property(const std::string& name) {
  const auto& names = host_properties();
  return name.starts_with("channel.") || std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace iotcloud::config
