#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/property_reader.h>

/// Properties that many drivers have, and what reads them.
namespace iotcloud::drivers::stream {

inline constexpr PropertySpec broker_property{.name = "broker",
                                              .text = "logical broker of all channels; the gateway's first"};

inline constexpr std::int64_t usual_most_bytes = 1 << 20, largest_most_bytes = 64 << 20;

/// A limit for what comes in one piece. \param text of what, and what becomes of a longer one
constexpr PropertySpec most_bytes_property(std::string_view text) {
  return {.name = "most_bytes",
          .type = PropertyType::integer,
          .unit = "bytes",
          .min = 1,
          .max = largest_most_bytes,
          .default_value = "1048576",
          .text = text};
}
inline std::size_t read_most_bytes(PropertyReader& reader) {
  return static_cast<std::size_t>(reader.integer("most_bytes", usual_most_bytes, 1, largest_most_bytes));
}

}  // namespace iotcloud::drivers::stream
