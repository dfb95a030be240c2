#pragma once

#include <chrono>
#include <concepts>
#include <cstddef>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

/// JSON from a struct's description, and back. Heavy to include: for sources only.
/// Texts, numbers, and lists and maps of them become JSON as they are. An id becomes its text, also in lists and as the
/// key of a map; a duration becomes its count in its own unit; an enumeration becomes what json_value(value) returns,
/// and parse(json, value) reads it back; a described struct becomes an object, also in lists, maps and optional fields.
/// A field with a form of its own (fields.h) becomes what its form makes of it, which may be JSON already.
/// JSON is read as input from strangers: a value of another type, a number with a fraction or one that does not fit
/// into its field is an error.
namespace iotcloud::discovery {

template <typename Json, Described Struct>
Json to_json(const Struct& value);
template <Described Struct, typename Json>
Struct from_json(const Json& json, const std::string& path);

namespace detail {

template <typename Value>
concept Optional = requires(Value value) {
  value.has_value();
};
template <typename Value>
concept Duration = requires(Value value) {
  value.count();
  Value::zero();
};
/// A map whose keys are ids.
template <typename Value>
concept MapOfIds = requires {
  requires AnyId<typename Value::key_type>;
  typename Value::mapped_type;
};
template <typename Value>
concept ListOfIds = requires {
  requires AnyId<typename Value::value_type>;
};
template <typename Value>
concept Map = requires {
  typename Value::key_type;
  typename Value::mapped_type;
};
template <typename Value>
concept List = requires(Value value) {
  value.emplace_back();
}
&&!std::same_as<Value, std::string>;
template <typename Value>
concept DescribedMap = requires {
  requires Described<typename Value::mapped_type>;
};
template <typename Value>
concept DescribedList = requires {
  requires Described<typename Value::value_type>;
}
&&!Optional<Value>;

template <typename Value>
bool is_empty(const Value& value) {
  if constexpr (Optional<Value>) {
    return !value.has_value();
  } else if constexpr (requires { value.empty(); }) {
    return value.empty();
  } else if constexpr (requires { value == Value{}; }) {
    return value == Value{};
  } else {
    return false;
  }
}

/// A value of the right type that its field cannot take.
struct UnfitValue : std::runtime_error {
  using runtime_error::runtime_error;
};

template <typename Json, typename Number>
void read_whole(const Json& json, Number& number) {
  if (!json.is_number_integer()) throw UnfitValue(std::string("a whole number is wanted, not ") + json.type_name());
  const bool fits = json.is_number_unsigned() ? std::in_range<Number>(json.template get<std::uint64_t>())
                                              : std::in_range<Number>(json.template get<std::int64_t>());
  if (!fits) throw UnfitValue("the number " + json.dump() + " is out of range");
  number = static_cast<Number>(json.template get<std::int64_t>());
}

template <typename Json, typename Value>
void read(const Json& json, Value& value, const std::string& path) {
  if constexpr (std::same_as<Value, Json>) {
    value = json;
  } else if constexpr (Described<Value>) {
    value = from_json<Value>(json, path);
  } else if constexpr (Optional<Value>) {
    if (!json.is_null()) read(json, value.emplace(), path);
  } else if constexpr (AnyId<Value>) {
    value = Value(json.template get<std::string>());
  } else if constexpr (Duration<Value>) {
    typename Value::rep count{};
    read(json, count, path);
    value = Value(count);
  } else if constexpr (std::is_enum_v<Value>) {
    decltype(json_value(value)) word{};
    read(json, word, path);
    parse(word, value);
  } else if constexpr (Map<Value>) {
    for (const auto& [key, item] : json.template get_ref<const typename Json::object_t&>()) {
      read(item, value[typename Value::key_type(key)],
           Described<typename Value::mapped_type> ? std::string(path).append(", ").append(key) : path);
    }
  } else if constexpr (List<Value>) {
    value.clear();
    for (const auto& item : json.template get_ref<const typename Json::array_t&>())
      read(item, value.emplace_back(), path);
  } else if constexpr (std::integral<Value> && !std::same_as<Value, bool>) {
    read_whole(json, value);
  } else {
    json.get_to(value);
  }
}

}  // namespace detail

/// Writes JSON on one line. Bytes that are not UTF-8 are replaced.
template <typename Json>
std::string to_text(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// The JSON of one value.
template <typename Json, typename Value>
Json json_of(const Value& value) {
  // NOLINTNEXTLINE(bugprone-branch-clone): the last branch makes a Json of another type
  if constexpr (std::same_as<Value, Json>) {
    return value;
  } else if constexpr (Described<Value>) {
    return to_json<Json>(value);
  } else if constexpr (detail::Optional<Value>) {
    return json_of<Json>(*value);
  } else if constexpr (AnyId<Value>) {
    return value.str();
  } else if constexpr (detail::MapOfIds<Value>) {
    Json object = Json::object();
    for (const auto& [key, item] : value) object[key.str()] = item;
    return object;
  } else if constexpr (detail::ListOfIds<Value>) {
    Json list = Json::array();
    for (const auto& item : value) list.push_back(item.str());
    return list;
  } else if constexpr (detail::Duration<Value>) {
    return value.count();
  } else if constexpr (std::is_enum_v<Value>) {
    return json_value(value);
  } else if constexpr (detail::DescribedMap<Value>) {
    Json object = Json::object();
    for (const auto& [key, item] : value) object[key] = to_json<Json>(item);
    return object;
  } else if constexpr (detail::DescribedList<Value>) {
    Json list = Json::array();
    for (const auto& item : value) list.push_back(to_json<Json>(item));
    return list;
  } else {
    return value;
  }
}

/// Keys stand in the order of the description when `Json` keeps an order.
template <typename Json, Described Struct>
Json to_json(const Struct& value) {
  Json json = Json::object();
  each_field<Struct>([&](const auto& field) {
    const auto& own = field.own(value);
    using Value = std::remove_cvref_t<decltype(own)>;
    const bool may_miss = (field.as_it_is && detail::Optional<Value>) || field.presence == Presence::rare;
    if (may_miss && detail::is_empty(own)) return;
    json[field.key] = json_of<Json>(field.to_travel(own));
  });
  return json;
}

/// Ignores keys that the description does not have, because newer programs write them. \param path says in messages
/// where the JSON came from. \throws config::Error naming `path` and the key.
template <Described Struct, typename Json>
Struct from_json(const Json& json, const std::string& path) {
  const std::string what = path + ": not " + Struct::what + ": ";
  if (!json.is_object()) throw config::Error(what + "a JSON object is wanted");
  Struct value;
  each_field<Struct>([&](const auto& field) {
    const auto found = json.find(field.key);
    const std::string key = std::string("the key \"") + field.key + '"';
    if (found == json.end()) {
      if (field.presence == Presence::required) throw config::Error(what + key + " is missing");
      return;
    }
    try {
      field.arrive(field.own(value), [&](auto& travelling) { detail::read(*found, travelling, path); });
    } catch (const typename Json::exception& error) {
      throw config::Error(what + key + ": " + error.what());
    } catch (const detail::UnfitValue& error) {
      throw config::Error(what + key + ": " + error.what());
    }
  });
  return value;
}

/// Most levels of lists and objects within each other in text that parse_json() takes. The records here have four; a
/// newer program's may have more.
inline constexpr int most_json_levels = 64;

/// Parses text from outside: every text that a process reads from the registry as JSON goes through this function. The
/// parser itself is not recursive, but what it returns is destroyed recursively, so deep nesting would end the process.
/// \param path says in messages where the text came from. \throws config::Error when the text is no JSON, is longer
/// than `longest` bytes (without the parameter: than a node may be, max_node_size), or has more than most_json_levels
/// levels.
nlohmann::json parse_json(const std::string& text, const std::string& path, std::size_t longest);
nlohmann::json parse_json(const std::string& text, const std::string& path);

/// As parse_json(), into another kind of JSON.
template <typename Json>
Json parse_json_as(std::string_view text, const std::string& path, std::size_t longest) {
  if (text.size() > longest) {
    throw config::Error(path + ": " + std::to_string(text.size()) + " bytes are more than it may have (" +
                        std::to_string(longest) + ")");
  }
  const auto not_too_deep = [&](int depth, typename Json::parse_event_t, const Json&) {
    if (depth <= most_json_levels) return true;
    throw config::Error(path + ": the JSON has more than " + std::to_string(most_json_levels) +
                        " levels of lists and objects within each other");
  };
  try {
    return Json::parse(text, not_too_deep);
  } catch (const typename Json::exception& error) {
    throw config::Error(path + " in JSON: " + error.what());
  }
}

/// Like from_json(), for text that is still to be parsed: parse_json().
template <Described Struct>
Struct from_text(const std::string& text, const std::string& path) {
  return from_json<Struct>(parse_json(text, path + ": not " + Struct::what), path);
}

}  // namespace iotcloud::discovery
