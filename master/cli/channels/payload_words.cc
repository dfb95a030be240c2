#include <algorithm>
#include <charconv>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/channels/payload_words.h>
#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;

namespace {

constexpr std::size_t shown_by_itself = 48;  ///< bytes in hexadecimal digits, when nobody asked for them
constexpr std::uint32_t depth_width = 640, depth_height = 480;

std::uint32_t byte_at(std::string_view bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes[at]);
}
std::uint32_t big16(std::string_view bytes, std::size_t at) {
  return byte_at(bytes, at) << 8U | byte_at(bytes, at + 1);
}
std::uint32_t big32(std::string_view bytes, std::size_t at) {
  return big16(bytes, at) << 16U | big16(bytes, at + 2);
}
std::uint32_t little16(std::string_view bytes, std::size_t at) {
  return byte_at(bytes, at) | byte_at(bytes, at + 1) << 8U;
}
std::uint32_t little32(std::string_view bytes, std::size_t at) {
  return little16(bytes, at) | little16(bytes, at + 2) << 16U;
}

/// Looks for the frame header among a JPEG's segments.
std::optional<ImageSize> jpeg_size(std::string_view jpeg) {
  std::size_t at = 2;
  while (at + 9 <= jpeg.size() && byte_at(jpeg, at) == 0xFF) {
    const std::uint32_t marker = byte_at(jpeg, at + 1);
    const bool frame = marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame) return ImageSize{"JPEG", big16(jpeg, at + 7), big16(jpeg, at + 5)};
    const std::uint32_t length = big16(jpeg, at + 2);
    if (length < 2) return std::nullopt;
    at += 2 + length;
  }
  return std::nullopt;
}

/// "P5 640 480 255": the head of a portable anymap.
std::optional<ImageSize> anymap_size(std::string_view text) {
  std::uint32_t numbers[2] = {0, 0};
  std::string_view rest = text.substr(2, 64);
  for (auto& number : numbers) {
    const auto digits = rest.find_first_not_of(" \t\r\n");
    if (digits == 0 || digits == std::string_view::npos) return std::nullopt;
    rest.remove_prefix(digits);
    const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), number);
    if (error != std::errc{}) return std::nullopt;
    rest.remove_prefix(static_cast<std::size_t>(end - rest.data()));
  }
  return ImageSize{"PNM", numbers[0], numbers[1]};
}

std::string hex(std::string_view bytes, const char* between) {
  std::string text;
  for (const char byte : bytes)
    text += fmt::format("{}{:02x}", text.empty() ? "" : between, static_cast<unsigned char>(byte));
  return text;
}

/// The JSON of a payload, which may come from anybody who may publish; discarded when it is none, or has so many levels
/// within each other that to write it, which is recursive, could end the process.
Json parse(std::string_view payload) {
  try {
    return discovery::parse_json_as<Json>(payload, "the payload", payload.size());
  } catch (const config::Error&) {
    return Json(Json::value_t::discarded);
  }
}

/// What `auto_` finds: the format, and the parsed JSON if it is that.
struct Found {
  PayloadFormat format = PayloadFormat::hex;
  Json json{};
  std::optional<ImageSize> image{};
};

Found find_format(std::string_view payload, bool whole, PayloadFormat wanted) {
  Found found;
  found.format = wanted;
  if (wanted == PayloadFormat::auto_ || wanted == PayloadFormat::image) found.image = image_size(payload);
  if (wanted == PayloadFormat::auto_ || wanted == PayloadFormat::json) {
    found.json = whole ? parse(payload) : Json(Json::value_t::discarded);
    if (wanted == PayloadFormat::json && found.json.is_discarded()) found.format = PayloadFormat::text;
  }
  if (wanted == PayloadFormat::image && !found.image) found.format = PayloadFormat::hex;
  if (wanted != PayloadFormat::auto_) return found;
  const bool structured = !found.json.is_discarded() && found.json.is_structured();
  found.format = found.image                ? PayloadFormat::image
                 : structured               ? PayloadFormat::json
                 : is_text(payload, !whole) ? PayloadFormat::text
                                            : PayloadFormat::hex;
  return found;
}

std::string rest_words(std::size_t shown, std::int64_t size) {
  return shown < static_cast<std::size_t>(size) ? fmt::format("... ({} B)", size) : "";
}

}  // namespace

std::optional<ImageSize> image_size(std::string_view payload) {
  using namespace std::string_view_literals;
  if (payload.size() >= 24 && payload.starts_with("\x89PNG\r\n\x1a\n"sv))
    return ImageSize{"PNG", big32(payload, 16), big32(payload, 20)};
  if (payload.starts_with("\xFF\xD8\xFF"sv)) return jpeg_size(payload);
  if (payload.size() >= 10 && payload.starts_with("GIF8"sv))
    return ImageSize{"GIF", little16(payload, 6), little16(payload, 8)};
  if (payload.size() >= 26 && payload.starts_with("BM"sv) && little32(payload, 14) >= 40)
    return ImageSize{"BMP", little32(payload, 18), little32(payload, 22)};
  if (payload.size() >= 8 && payload[0] == 'P' && payload[1] >= '1' && payload[1] <= '6') return anymap_size(payload);
  // The codecs that drivers/depth/README.md describes: 307 200 as Snappy writes it, or their own head.
  if (payload.starts_with("\x80\xE0\x12"sv) || payload.starts_with("IDC"sv))
    return ImageSize{"depth", depth_width, depth_height};
  return std::nullopt;
}

bool is_text(std::string_view bytes, bool cut) {
  std::size_t at = 0;
  while (at < bytes.size()) {
    const std::uint32_t first = byte_at(bytes, at);
    if (first < 0x80) {
      if (first == 0x7F || (first < 0x20 && first != '\n' && first != '\r' && first != '\t')) return false;
      ++at;
      continue;
    }
    const std::size_t length = first >= 0xF0 && first <= 0xF4 ? 4 : first >= 0xE0 ? 3 : first >= 0xC2 ? 2 : 0;
    if (length == 0 || first > 0xF4) return false;
    for (std::size_t i = 1; i < length; ++i) {
      if (at + i >= bytes.size()) return cut;
      if ((byte_at(bytes, at + i) & 0xC0U) != 0x80) return false;
    }
    at += length;
  }
  return true;
}

std::string payload_words(std::string_view payload, std::int64_t size, PayloadFormat format) {
  const bool whole = payload.size() == static_cast<std::size_t>(size);
  const Found found = find_format(payload, whole, format);
  switch (found.format) {
    case PayloadFormat::image:
      return fmt::format("<{} image {}x{}, {} B>", found.image->kind, found.image->width, found.image->height, size);
    case PayloadFormat::json:
      return found.json.dump(-1, ' ', false, Json::error_handler_t::replace);
    case PayloadFormat::text:
      return printable(std::string(payload)) + rest_words(payload.size(), size);
    case PayloadFormat::auto_:
    case PayloadFormat::hex:
      break;
  }
  const auto shown = format == PayloadFormat::hex ? payload : payload.substr(0, shown_by_itself);
  return fmt::format("<{} B{}{}>{}", size, shown.empty() ? "" : ": ", hex(shown, " "),
                     shown.size() < static_cast<std::size_t>(size) ? "..." : "");
}

nlohmann::ordered_json payload_json(std::string_view payload, std::int64_t size, PayloadFormat format) {
  const Found found = find_format(payload, payload.size() == static_cast<std::size_t>(size), format);
  switch (found.format) {
    case PayloadFormat::image:
      return {
          {"format", "image"},
          {"payload", {{"kind", found.image->kind}, {"width", found.image->width}, {"height", found.image->height}}}};
    case PayloadFormat::json:
      return {{"format", "json"}, {"payload", found.json}};
    case PayloadFormat::text:
      return {{"format", "text"}, {"payload", std::string(payload)}};
    case PayloadFormat::auto_:
    case PayloadFormat::hex:
      break;
  }
  return {{"format", "hex"}, {"payload", hex(payload, "")}};
}

std::string byte_words(double bytes) {
  constexpr double kilo = 1000, mega = 1000 * kilo;
  if (bytes >= mega) return fmt::format("{:.1f} MB", bytes / mega);
  if (bytes >= kilo) return fmt::format("{:.1f} kB", bytes / kilo);
  return fmt::format("{:.0f} B", bytes);
}

}  // namespace iotcloud::master::cli
