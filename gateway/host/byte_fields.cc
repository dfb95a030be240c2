#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <string_view>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/byte_fields.h>

namespace iotcloud::gateway {

namespace {

constexpr std::string_view digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

std::string text_of(std::string_view bytes) {
  std::string text((bytes.size() + 2) / 3 * 4, '=');
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t here = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      group = group << 8U | (k < here ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k <= here; ++k) text[i / 3 * 4 + k] = digits[group >> (18U - 6U * k) & 0x3FU];
  }
  return text;
}

/// The value of each character in base64; 255: it is none.
constexpr std::array<std::uint8_t, 256> values_of_digits() {
  std::array<std::uint8_t, 256> values{};
  values.fill(255);
  for (std::size_t i = 0; i < digits.size(); ++i) {
    values[static_cast<unsigned char>(digits[i])] = static_cast<std::uint8_t>(i);
  }
  return values;
}

/// \throws config::Error for a text that text_of() does not make.
std::string bytes_of(const std::string& text) {
  static constexpr auto values = values_of_digits();
  std::size_t end = text.size();
  for (int padding = 0; padding < 2 && end > 0 && text[end - 1] == '='; ++padding) --end;
  std::string bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t group = 0;
  bool readable = text.size() % 4 == 0;
  for (std::size_t i = 0; i < end && readable; ++i) {
    const auto value = values[static_cast<unsigned char>(text[i])];
    readable = value != 255;
    group = group << 6U | value;
    if (i % 4 != 0) bytes.push_back(static_cast<char>(group >> (6U - 2U * (i % 4)) & 0xFFU));
  }
  if (!readable) throw config::Error("a passed message has a part that is not base64");
  return bytes;
}

/// Both keys and values.
template <typename Convert>
std::map<std::string, std::string> converted(const std::map<std::string, std::string>& map, Convert&& convert) {
  std::map<std::string, std::string> result;
  for (const auto& [key, value] : map) result[convert(key)] = convert(value);
  return result;
}

}  // namespace

std::string AsBase64::to(const std::string& bytes) {
  return text_of(bytes);
}
void AsBase64::from(const std::string& text, std::string& bytes) {
  bytes = bytes_of(text);
}
std::string AsBase64::to(const brokers::Payload& payload) {
  return text_of(payload.text());
}
void AsBase64::from(const std::string& text, brokers::Payload& payload) {
  payload = brokers::Payload::take(bytes_of(text));
}

std::vector<std::pair<std::string, std::string>> AsBase64Pairs::to(const brokers::Properties& properties) {
  std::vector<std::pair<std::string, std::string>> pairs;
  pairs.reserve(properties.size());
  for (const auto& [key, value] : properties) pairs.emplace_back(text_of(key), text_of(value));
  return pairs;
}
void AsBase64Pairs::from(const std::vector<std::pair<std::string, std::string>>& pairs,
                         brokers::Properties& properties) {
  for (const auto& [key, value] : pairs) properties.set(bytes_of(key), bytes_of(value));
}

discovery::ChannelLook WithBase64::to(discovery::ChannelLook look) {
  for (auto& message : look.messages) {
    message.payload = text_of(message.payload);
    message.properties = converted(message.properties, text_of);
  }
  return look;
}
void WithBase64::from(discovery::ChannelLook travelling, discovery::ChannelLook& look) {
  look = std::move(travelling);
  for (auto& message : look.messages) {
    message.payload = bytes_of(message.payload);
    message.properties = converted(message.properties, bytes_of);
  }
}

}  // namespace iotcloud::gateway
