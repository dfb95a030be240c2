#include <algorithm>
#include <cstddef>
#include <cstdint>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/yaml/text.h>

namespace iotcloud::config::internal {
namespace {

struct Character {
  std::uint32_t code = 0;
  std::size_t bytes = 0;  ///< 0: not UTF-8
};

/// The first character of `text`, which is not empty. Overlong forms and surrogates are not UTF-8 (RFC 3629).
Character decode(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char first = byte(0);
  if (first < 0x80) return {first, 1};
  Character character;
  std::uint32_t least = 0;
  if ((first & 0xE0) == 0xC0) {
    character = {first & 0x1FU, 2};
    least = 0x80;
  } else if ((first & 0xF0) == 0xE0) {
    character = {first & 0x0FU, 3};
    least = 0x800;
  } else if ((first & 0xF8) == 0xF0) {
    character = {first & 0x07U, 4};
    least = 0x10000;
  } else {
    return {};
  }
  if (text.size() < character.bytes) return {};
  for (std::size_t i = 1; i < character.bytes; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return {};
    character.code = character.code << 6 | (byte(i) & 0x3FU);
  }
  const bool is_surrogate = character.code >= 0xD800 && character.code <= 0xDFFF;
  if (character.code < least || character.code > 0x10FFFF || is_surrogate) return {};
  return character;
}

bool is_allowed(std::uint32_t code) {
  if (code < 0x20) return code == '\t' || code == '\n' || code == '\r';
  if (code < 0x7F) return true;
  if (code < 0xA0) return code == 0x85;
  return code != 0xFFFE && code != 0xFFFF;
}

/// Counts lines only for an error message: most texts need no place.
Location place(std::string_view text, std::size_t offset, const std::string& name) {
  const std::string_view before = text.substr(0, offset);
  const auto line = 1 + std::count(before.begin(), before.end(), '\n');
  const std::size_t begin = before.rfind('\n') + 1;  // npos + 1 is 0
  return {name, static_cast<int>(line), static_cast<int>(offset - begin + 1)};
}

}  // namespace

std::string_view checked_text(std::string_view text, const std::string& name) {
  if (text.size() > most_text_bytes) {
    throw ConfigError({name, 0, 0}, "", fmt::format("this text is longer than {} MiB", most_text_bytes >> 20),
                      "split it");
  }
  constexpr std::string_view utf8_mark = "\xEF\xBB\xBF";
  if (text.starts_with("\xFE\xFF") || text.starts_with("\xFF\xFE")) {
    throw ConfigError({name, 1, 1}, "", "this text is UTF-16, only UTF-8 is read", "save it as UTF-8");
  }
  if (text.starts_with(utf8_mark)) text.remove_prefix(utf8_mark.size());
  for (std::size_t at = 0; at < text.size();) {
    const Character character = decode(text.substr(at));
    if (character.bytes == 0) {
      throw ConfigError(place(text, at, name), "",
                        fmt::format("the byte 0x{:02x}, byte {} of the text, is no valid UTF-8",
                                    static_cast<unsigned char>(text[at]), at + 1),
                        "save the text as UTF-8, or remove the byte");
    }
    if (!is_allowed(character.code)) {
      throw ConfigError(
          place(text, at, name), "",
          fmt::format("YAML does not allow the character U+{:04X}, byte {} of the text", character.code, at + 1),
          fmt::format("remove it, or write \\u{:04x} within double quotes", character.code));
    }
    at += character.bytes;
  }
  return text;
}

}  // namespace iotcloud::config::internal
