#pragma once

#include <tuple>

/// One description for each struct that travels: an order, a record of the registry, an answer of a service. It lists
/// the struct's fields once; description/json.h and description/wire.h make the encodings from that list.
namespace iotcloud::discovery {

/// When a field is written, and what a reader does when it is missing.
enum class Presence {
  required,  ///< always written; a reader refuses data without it
  usual,     ///< always written; a reader gives it its default when it is missing
  rare,      ///< written only when it is not empty, 0 or false, so that programs older than the field see nothing new
};

/// One field: its key in JSON, and its places in the struct and in the struct that Thrift generates.
template <typename Own, typename Wire>
struct Field {
  const char* key;
  Presence presence;
  Own own;    ///< own(object) returns the field
  Wire wire;  ///< wire(thrift_object, use) calls use(field, is_set) with the field and its "is set" flag
};
template <typename Own, typename Wire>
Field(const char*, Presence, Own, Wire) -> Field<Own, Wire>;

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
#define IOTCLOUD_FIELD_AS(member, presence, json_key, wire_member)                                    \
  ::iotcloud::discovery::Field {                                                                      \
    json_key, ::iotcloud::discovery::Presence::presence, [](auto& object) -> auto& {                  \
      return object.member;                                                                           \
    }                                                                                                 \
    , [](auto& wire, auto&& use) {                                                                    \
      bool is_set = true;                                                                             \
      if constexpr (requires { wire.__isset.wire_member; }) is_set = wire.__isset.wire_member;        \
      use(wire.wire_member, is_set);                                                                  \
      if constexpr (requires { wire.__isset.wire_member = true; }) wire.__isset.wire_member = is_set; \
    }                                                                                                 \
  }
