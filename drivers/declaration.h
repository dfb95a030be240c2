#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string_view>

/// How a driver declares its properties, so that orders are checked against them before anything is ordered.
namespace iotcloud::drivers {

/// The types of a property's values.
enum class PropertyType { text, number, integer, flag };

/// The values that a text may have; none: any.
class PropertyChoices {
 public:
  static constexpr std::size_t most = 16;

  constexpr PropertyChoices() = default;
  constexpr PropertyChoices(std::initializer_list<std::string_view> words) {
    for (const std::string_view word : words) add(word);
  }
  constexpr void add(std::string_view word) {
    if (size_ == most) throw std::invalid_argument("a property has more than 16 choices");
    words_.at(size_++) = word;
  }
  constexpr const std::string_view* begin() const { return words_.data(); }
  constexpr const std::string_view* end() const { return words_.data() + size_; }
  constexpr bool empty() const { return size_ == 0; }

 private:
  std::array<std::string_view, most> words_{};
  std::size_t size_ = 0;
};

/// One property that a driver declares. A mistake in a declaration is an error of the compiler.
///
///     class Station : public Driver {
///      public:
///       static constexpr std::string_view description = "A weather station";
///       static constexpr std::array declared_properties{
///           PropertySpec{.name = "rate", .type = PropertyType::number, .unit = "1/s", .min = 0.1, .max = 1000,
///                        .default_value = "10", .text = "readings a second"}};
///
/// A driver without the member `declared_properties` declares nothing, and gets any. Both members are
/// optional, each by itself. Properties of the driver host (`channel.NAME.OPTION`, `thread`, ...) are not declared.
struct PropertySpec {
  std::string_view name;
  PropertyType type = PropertyType::text;
  std::string_view unit{};  ///< "ms", "1/s"; for people
  /// Bounds of a number, of at most 9 decimals.
  std::optional<double> min{}, max{};
  /// The driver finds this value in its properties when a deployment gives none.
  std::optional<std::string_view> default_value{};
  bool required = false;      ///< a deployment must give it
  PropertyChoices choices{};  ///< of a text
  std::string_view text{};    ///< what it is, for people
};

/// This text and a JSON object stand in a plugin's bytes, so that its declaration is read without loading the plugin;
/// config/declaration.h does.
#define IOTCLOUD_DRIVER_DECLARATION_MARK "iotcloud-plugin: declaration="
/// The same of its name and version.
#define IOTCLOUD_DRIVER_CARD_MARK "iotcloud-plugin: driver="

namespace detail {

/// Throws in a constant expression, which the compiler reports with the text.
constexpr void refuse_declaration_unless(bool good, const char* text) {
  if (!good) throw std::invalid_argument(text);
}

/// A decimal number, without an exponent; nullopt: it is none.
constexpr std::optional<double> decimal(std::string_view text) {
  const bool negative = text.starts_with('-');
  if (negative) text.remove_prefix(1);
  double value = 0, scale = 1;
  std::size_t digits = 0;
  bool fraction = false;
  for (const char c : text) {
    if (c == '.' && !fraction) {
      fraction = true;
    } else if (c >= '0' && c <= '9') {
      value = value * 10 + (c - '0');
      if (fraction) scale *= 10;
      ++digits;
    } else {
      return std::nullopt;
    }
  }
  if (digits == 0) return std::nullopt;
  return (negative ? -value : value) / scale;
}

/// Writes JSON into `out`, which counts or keeps the characters.
template <typename Out>
struct DeclarationWriter {
  Out& out;

  constexpr void raw(std::string_view text) {
    for (const char c : text) out.put(c);
  }
  constexpr void text(std::string_view text) {
    constexpr std::string_view hex = "0123456789abcdef";
    out.put('"');
    for (const char c : text) {
      const auto byte = static_cast<unsigned char>(c);
      if (c == '"' || c == '\\') {
        out.put('\\');
        out.put(c);
      } else if (byte < 0x20) {
        raw("\\u00");
        out.put(hex[byte >> 4]);
        out.put(hex[byte & 0xf]);
      } else {
        out.put(c);
      }
    }
    out.put('"');
  }
  constexpr void whole(std::uint64_t number, int least_digits) {
    std::array<char, 20> digits{};
    int count = 0;
    for (; number > 0 || count < least_digits; number /= 10)
      digits[static_cast<std::size_t>(count++)] = static_cast<char>('0' + number % 10);
    while (count > 0) out.put(digits[static_cast<std::size_t>(--count)]);
  }
  constexpr void number(double value) {
    constexpr double most = 9e15;  // a double holds each whole number up to here
    refuse_declaration_unless(value >= -most && value <= most, "a bound of a property is beyond 9e15: leave it out");
    if (value < 0) out.put('-');
    if (value < 0) value = -value;
    int decimals = 0;
    double scale = 1;
    constexpr int most_decimals = 9;
    // std::lround() is not constexpr.
    const auto scaled = [&] { return (static_cast<std::uint64_t>(2 * value * scale) + 1) / 2; };
    for (; static_cast<double>(scaled()) / scale != value; scale *= 10, ++decimals)
      refuse_declaration_unless(decimals < most_decimals && value * scale < most / 10,
                                "a bound of a property has more decimals than a declaration can hold");
    const auto all = scaled();
    const auto split = static_cast<std::uint64_t>(scale);
    whole(all / split, 1);
    if (decimals == 0) return;
    out.put('.');
    whole(all % split, decimals);
  }
  constexpr void key(std::string_view name) {
    out.put(',');
    text(name);
    out.put(':');
  }
  constexpr void member(std::string_view name, std::string_view value) {
    key(name);
    text(value);
  }
  constexpr void member(std::string_view name, double value) {
    key(name);
    number(value);
  }
};

constexpr std::string_view type_word(PropertyType type) {
  constexpr std::array<std::string_view, 4> words{"text", "number", "integer", "flag"};
  return words[static_cast<std::size_t>(type)];
}

constexpr bool is_choice(const PropertySpec& spec, std::string_view value) {
  for (const auto choice : spec.choices) {
    if (choice == value) return true;
  }
  return spec.choices.empty();
}

constexpr void check_default(const PropertySpec& spec) {
  if (!spec.default_value) return;
  const auto value = *spec.default_value;
  refuse_declaration_unless(!spec.required, "a property that is required needs no default_value");
  refuse_declaration_unless(is_choice(spec, value), "the default_value of a property is none of its choices");
  if (spec.type == PropertyType::flag)
    refuse_declaration_unless(value == "true" || value == "false", "the default_value of a flag is true or false");
  if (spec.type != PropertyType::number && spec.type != PropertyType::integer) return;
  const auto number = decimal(value);
  refuse_declaration_unless(number.has_value(), "the default_value of a number is none, such as -0.5");
  refuse_declaration_unless(spec.type == PropertyType::number || value.find('.') == std::string_view::npos,
                            "the default_value of an integer is no whole number");
  refuse_declaration_unless((!spec.min || *number >= *spec.min) && (!spec.max || *number <= *spec.max),
                            "the default_value of a property is out of its range");
}

constexpr void check(const PropertySpec& spec) {
  const bool counts = spec.type == PropertyType::number || spec.type == PropertyType::integer;
  refuse_declaration_unless(!spec.name.empty(), "a property has no name");
  refuse_declaration_unless(!spec.name.starts_with("channel."), "a property channel.* is the driver host's");
  refuse_declaration_unless(counts || (!spec.min && !spec.max), "only numbers have min and max");
  refuse_declaration_unless(!spec.min || !spec.max || *spec.min <= *spec.max, "min is above max");
  refuse_declaration_unless(spec.type == PropertyType::text || spec.choices.empty(), "only texts have choices");
  check_default(spec);
}

template <typename Out>
constexpr void write(DeclarationWriter<Out>& to, const PropertySpec& spec) {
  check(spec);
  to.raw("{\"name\":");
  to.text(spec.name);
  to.member("type", type_word(spec.type));
  if (!spec.unit.empty()) to.member("unit", spec.unit);
  if (spec.min) to.member("min", *spec.min);
  if (spec.max) to.member("max", *spec.max);
  if (spec.default_value) to.member("default", *spec.default_value);
  if (spec.required) {
    to.key("required");
    to.raw("true");
  }
  if (!spec.choices.empty()) {
    to.key("choices");
    to.raw("[");
    for (const std::string_view& choice : spec.choices) {
      if (&choice != spec.choices.begin()) to.raw(",");
      to.text(choice);
    }
    to.raw("]");
  }
  if (!spec.text.empty()) to.member("text", spec.text);
  to.raw("}");
}

template <typename UserDriver>
concept DeclaresProperties = requires {
  UserDriver::declared_properties.size();
};
template <typename UserDriver>
concept DescribesItself = requires {
  { UserDriver::description } -> std::convertible_to<std::string_view>;
};

template <typename UserDriver, typename Out>
constexpr void write_declaration(Out& out) {
  DeclarationWriter<Out> to{out};
  to.raw(IOTCLOUD_DRIVER_DECLARATION_MARK "{\"description\":");
  if constexpr (DescribesItself<UserDriver>) {
    to.text(UserDriver::description);
  } else {
    to.text("");
  }
  if constexpr (DeclaresProperties<UserDriver>) {
    to.key("properties");
    to.raw("[");
    bool first = true;
    for (const PropertySpec& spec : UserDriver::declared_properties) {
      if (!first) to.raw(",");
      first = false;
      write(to, spec);
    }
    to.raw("]");
  }
  to.raw("}");
  out.put('\0');
}

struct CountedText {
  std::size_t size = 0;
  constexpr void put(char) { ++size; }
};

template <std::size_t Size>
struct KeptText {
  std::array<char, Size> bytes{};
  std::size_t size = 0;
  constexpr void put(char c) { bytes.at(size++) = c; }
};

template <typename UserDriver>
consteval auto make_declaration() {
  constexpr std::size_t size = [] {
    CountedText counted;
    write_declaration<UserDriver>(counted);
    return counted.size;
  }();
  KeptText<size> kept;
  write_declaration<UserDriver>(kept);
  return kept.bytes;
}

/// The mark and the JSON of a driver, and a zero byte.
template <typename UserDriver>
inline constexpr auto declaration_with_mark = make_declaration<UserDriver>();

/// The JSON; nullptr: the driver declares nothing and does not describe itself.
template <typename UserDriver>
constexpr const char* declaration_of() {
  if constexpr (DeclaresProperties<UserDriver> || DescribesItself<UserDriver>) {
    return declaration_with_mark<UserDriver>.data() + sizeof(IOTCLOUD_DRIVER_DECLARATION_MARK) - 1;
  } else {
    return nullptr;
  }
}

/// The mark and the JSON of a driver's name and version, as IOTCLOUD_DRIVER gets them.
consteval auto card_with_mark(std::string_view name, std::string_view version, bool /*own_thread*/ = false) {
  constexpr std::size_t most = 512;
  KeptText<most> kept;
  DeclarationWriter<KeptText<most>> to{kept};
  to.raw(IOTCLOUD_DRIVER_CARD_MARK "{\"name\":");
  to.text(name);
  to.member("version", version);
  to.raw("}");
  kept.put('\0');
  return kept.bytes;
}

}  // namespace detail
}  // namespace iotcloud::drivers
