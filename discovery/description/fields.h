#pragma once

#include <concepts>
#include <tuple>
#include <type_traits>
#include <utility>

/// One description for each struct that travels: an order, a record of the registry, an answer of a service. It lists
/// the struct's fields once; description/json.h and description/wire.h make the encodings from that list.
namespace iotcloud::discovery {

/// When a field is written, and what a reader does when it is missing.
enum class Presence {
  required,  ///< always written; a reader refuses data without it
  usual,     ///< always written; a reader gives it its default when it is missing
  rare,      ///< written only when it is not empty, 0 or false, so that programs older than the field see nothing new
};

/// The form of a field whose value travels as it is. Any other form is a struct with two functions:
///   static Travelling to(const Value& value);              // what travels: a value that the encodings know
///   static void from(Travelling travelling, Value& value);  // \throws config::Error
struct AsItIs {};

/// One field: its key in JSON, and its places in the struct and in the struct that Thrift generates.
template <typename Own, typename Wire, typename Form>
struct Field {
  const char* key;
  Presence presence;
  Own own;    ///< own(object) returns the field
  Wire wire;  ///< wire(thrift_object, use) calls use(field, is_set) with the field and its "is set" flag
  Form form;  ///< AsItIs, or in what form the value travels
  static constexpr bool as_it_is = std::same_as<Form, AsItIs>;

  /// What travels of this value of the field.
  template <typename Value>
  static decltype(auto) to_travel(const Value& value) {
    if constexpr (as_it_is) {
      return (value);
    } else {
      return Form::to(value);
    }
  }
  /// Calls `read` with what it is to read into, then sets the field's value by it.
  template <typename Value, typename Read>
  static void arrive(Value& value, Read&& read) {
    if constexpr (as_it_is) {
      read(value);
    } else {
      std::remove_cvref_t<decltype(Form::to(value))> travelling{};
      read(travelling);
      Form::from(std::move(travelling), value);
    }
  }
};
template <typename Own, typename Wire, typename Form>
Field(const char*, Presence, Own, Wire, Form) -> Field<Own, Wire, Form>;

/// A field of a member, as a field of the struct that has the member. \param reach reach(object) returns the member
template <typename Reach, typename Own, typename Wire, typename Form>
constexpr auto field_within(Reach reach, Field<Own, Wire, Form> field) {
  const auto own = [ reach, inner = field.own ](auto& object) -> auto& {
    return inner(reach(object));
  };
  return Field{field.key, field.presence, own, field.wire, field.form};
}
/// All fields of a member, as fields of the struct that has the member.
template <typename Reach, typename... Fields>
constexpr auto fields_within(Reach reach, const std::tuple<Fields...>& fields) {
  return std::apply([&](const auto&... field) { return std::tuple{field_within(reach, field)...}; }, fields);
}

/// A struct that describes itself:
///   static constexpr const char* what = "an order";  // names the struct in error messages
///   static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(plugin, required), ...};
template <typename Struct>
concept Described = requires {
  Struct::what;
  Struct::fields;
};

/// Calls `use` with each field of a struct.
template <typename Struct, typename Use>
constexpr void each_field(Use&& use) {
  std::apply([&](const auto&... field) { (use(field), ...); }, Struct::fields);
}

}  // namespace iotcloud::discovery

/// Describes a field that has the same name in the struct, in JSON and in Thrift.
#define IOTCLOUD_FIELD(member, presence) IOTCLOUD_FIELD_AS(member, presence, #member, member)

/// Describes a field whose key in JSON, or whose name in Thrift, differs from its name in the struct.
#define IOTCLOUD_FIELD_AS(member, presence, json_key, wire_member) \
  IOTCLOUD_FIELD_IN(::iotcloud::discovery::AsItIs, member, presence, json_key, wire_member)

/// Describes a field that travels in a form of its own (AsItIs says what a form is).
// NOLINTBEGIN(bugprone-macro-parentheses): the form is a type.
#define IOTCLOUD_FIELD_IN(form, member, presence, json_key, wire_member)                                  \
  ::iotcloud::discovery::Field {                                                                          \
    json_key, ::iotcloud::discovery::Presence::presence, [](auto& object) -> auto& {                      \
      return object.member;                                                                               \
    }                                                                                                     \
    ,                                                                                                     \
        [](auto& wire, auto&& use) {                                                                      \
          bool is_set = true;                                                                             \
          if constexpr (requires { wire.__isset.wire_member; }) is_set = wire.__isset.wire_member;        \
          use(wire.wire_member, is_set);                                                                  \
          if constexpr (requires { wire.__isset.wire_member = true; }) wire.__isset.wire_member = is_set; \
        },                                                                                                \
        form {}                                                                                           \
  }
// NOLINTEND(bugprone-macro-parentheses)

/// Describes the fields of a member, a struct that describes itself, as if they were the struct's own: a tuple of them.
#define IOTCLOUD_FIELDS_OF(member, Struct) \
  ::iotcloud::discovery::fields_within(    \
      [](auto& object) -> auto& { return object.member; }, Struct::fields)
