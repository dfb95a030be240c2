#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include <nlohmann/json_fwd.hpp>

namespace iotcloud::master::cli {

/// The forms in which a person can read a payload. `auto_` picks one by the bytes.
enum class PayloadFormat { auto_, text, json, hex, image };

/// "JPEG", 640, 480.
struct ImageSize {
  const char* kind = "";
  std::uint32_t width = 0, height = 0;
};

/// The size of an image in a payload, from the image's head: JPEG, PNG, GIF, BMP, PNM, and depth frames of the Kinect
/// driver. nullopt: it is none of them.
std::optional<ImageSize> image_size(std::string_view payload);

/// Whether bytes are UTF-8 without control characters, but for line ends and TAB. \param cut the last character may be
/// cut off
bool is_text(std::string_view bytes, bool cut = false);

/// One payload in one line.
/// \param payload the beginning of it, all of it, or nothing. \param size in bytes, of the whole
std::string payload_words(std::string_view payload, std::int64_t size, PayloadFormat format);
/// The same as data: its members are `format` ("json", "text", "hex" or "image") and `payload`.
nlohmann::ordered_json payload_json(std::string_view payload, std::int64_t size, PayloadFormat format);

/// "512 B", "1.2 kB", "3.4 MB".
std::string byte_words(double bytes);

}  // namespace iotcloud::master::cli
