#pragma once

#include <string>
#include <type_traits>
#include <utility>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

/// Converts a described struct into the struct that Thrift generates, and back. Enumerations have the same numbers on
/// both sides, or are the texts of description/json.h, an id is its text, a duration is its count in its own unit
/// (when it is optional, a number from Thrift that is not above 0 means that it is not set), and described structs may
/// stand in lists, maps and optional fields. A field with a form of its own (fields.h) is converted in that form.
namespace iotcloud::discovery {

template <Described Own, typename Wire>
void fill_wire(const Own& own, Wire& wire);
template <typename Wire, Described Own>
void fill_own(Wire& wire, Own& own);

namespace detail {

template <typename Value>
concept OptionalValue = requires(Value value) {
  value.has_value();
};
template <typename Value>
concept TimeSpan = requires {
  typename Value::rep;
};
template <typename Value>
concept MapOfValues = requires {
  typename Value::mapped_type;
};
template <typename Value>
concept ListOfValues = requires(Value value) {
  value.emplace_back();
};

template <typename AnyField>
inline constexpr bool as_it_is = std::remove_cvref_t<AnyField>::as_it_is;

template <typename Own, typename Wire>
void convert(const Own& own, Wire& wire) {
  // NOLINTNEXTLINE(bugprone-branch-clone): one type, containers too, and last what converts by itself
  if constexpr (std::is_same_v<Own, Wire>) {
    wire = own;
  } else if constexpr (Described<Own>) {
    fill_wire(own, wire);
  } else if constexpr (AnyId<Own>) {
    wire = own.str();
  } else if constexpr (TimeSpan<Own>) {
    wire = own.count();
  } else if constexpr (std::is_enum_v<Own> && std::is_same_v<Wire, std::string>) {
    wire = json_value(own);
  } else if constexpr (std::is_enum_v<Own>) {
    wire = static_cast<Wire>(own);
  } else if constexpr (MapOfValues<Own>) {
    for (const auto& [key, item] : own) convert(item, wire[key]);
  } else if constexpr (ListOfValues<Own>) {
    wire.reserve(own.size());
    for (const auto& item : own) convert(item, wire.emplace_back());
  } else {
    wire = own;
  }
}

template <typename Wire, typename Own>
void convert_back(Wire& wire, Own& own) {
  if constexpr (Described<Own>) {
    fill_own(wire, own);
  } else if constexpr (AnyId<Own>) {
    own = Own(std::move(wire));  // copies what is const
  } else if constexpr (TimeSpan<Own>) {
    own = Own(wire);
  } else if constexpr (std::is_enum_v<Own>) {
    own = static_cast<Own>(wire);
  } else if constexpr (std::is_same_v<Own, std::remove_const_t<Wire>>) {
    own = std::move(wire);  // copies what is const
  } else if constexpr (MapOfValues<Own>) {
    for (auto& [key, item] : wire) convert_back(item, own[typename Own::key_type(key)]);
  } else if constexpr (ListOfValues<Own>) {
    own.reserve(wire.size());
    for (auto& item : wire) convert_back(item, own.emplace_back());
  } else {
    own = wire;
  }
}

template <typename Value>
bool says_nothing(const Value& value) {
  if constexpr (requires { value.empty(); }) {
    return value.empty();
  } else if constexpr (requires { value == Value{}; }) {
    return value == Value{};
  } else {
    return false;
  }
}

}  // namespace detail

/// \param wire as its constructor made it.
template <Described Own, typename Wire>
void fill_wire(const Own& own, Wire& wire) {
  each_field<Own>([&](const auto& field) {
    const auto& value = field.own(own);
    field.wire(wire, [&](auto& place, bool& is_set) {
      if constexpr (detail::as_it_is<decltype(field)> && detail::OptionalValue<std::remove_cvref_t<decltype(value)>>) {
        if (!value) return;
        detail::convert(*value, place);
      } else {
        if (field.presence == Presence::rare && detail::says_nothing(value)) return;
        detail::convert(field.to_travel(value), place);
      }
      is_set = true;
    });
  });
}

/// Moves values out of `wire` unless it is const. \param own as its constructor made it.
template <typename Wire, Described Own>
void fill_own(Wire& wire, Own& own) {
  each_field<Own>([&](const auto& field) {
    auto& value = field.own(own);
    field.wire(wire, [&](auto& place, [[maybe_unused]] bool is_set) {
      using Value = std::remove_cvref_t<decltype(value)>;
      if constexpr (!detail::as_it_is<decltype(field)> || !detail::OptionalValue<Value>) {
        field.arrive(value, [&](auto& travelling) { detail::convert_back(place, travelling); });
      } else if constexpr (detail::TimeSpan<typename Value::value_type>) {
        if (place > 0) detail::convert_back(place, value.emplace());
      } else {
        if (is_set) detail::convert_back(place, value.emplace());
      }
    });
  });
}

template <typename Wire, Described Own>
Wire as_wire(const Own& own) {
  Wire wire;
  fill_wire(own, wire);
  return wire;
}
template <Described Own, typename Wire>
Own as_own(Wire&& wire) {
  Own own;
  fill_own(wire, own);
  return own;
}

}  // namespace iotcloud::discovery
