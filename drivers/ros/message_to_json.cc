#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <type_traits>
#include <utility>

#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/drivers/ros/message_type.h>

namespace iotcloud::drivers::ros {

/// Writes a message's bytes as JSON.
class MessageType::Reader {
 public:
  Reader(std::span<const std::byte> bytes, std::size_t most_bytes) : rest_(bytes), most_(most_bytes) {}

  std::string read(const Struct& type) {
    object(type);
    if (!rest_.empty()) throw FormatError(std::to_string(rest_.size()) + " bytes too many for " + type.name);
    return std::move(json_);
  }

 private:
  void put(std::string_view text) {
    if (json_.size() + text.size() > most_)
      throw FormatError("it is longer than " + std::to_string(most_) + " bytes as JSON (most_bytes)");
    json_ += text;
  }
  std::span<const std::byte> take(std::size_t count, const Field& field) {
    if (count > rest_.size()) throw FormatError("the bytes end within the field " + field.name);
    const auto taken = rest_.first(count);
    rest_ = rest_.subspan(count);
    return taken;
  }
  template <typename Number>
  Number take(const Field& field) {
    Number number;
    std::memcpy(&number, take(sizeof number, field).data(), sizeof number);
    return number;
  }
  template <typename Number>
  void number(const Field& field) {
    const auto value = take<Number>(field);
    if constexpr (std::is_floating_point_v<Number>) {
      if (!std::isfinite(value)) return put("null");
    }
    constexpr std::size_t most_digits = 32;
    std::array<char, most_digits> text{};
    const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
    put({text.data(), static_cast<std::size_t>(end - text.data())});
  }
  template <typename Number>
  void moment(const Field& field) {
    put("{\"secs\":");
    number<Number>(field);
    put(",\"nsecs\":");
    number<Number>(field);
    put("}");
  }
  void text(std::string_view text) {
    if (text.size() > most_) put(text);  // which refuses it
    put(nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  }
  void object(const Struct& type) {
    put("{");
    bool first = true;
    for (const Field& field : type.fields) {
      put(std::exchange(first, false) ? "\"" : ",\"");
      put(field.name);
      put("\":");
      value(field);
    }
    put("}");
  }
  void value(const Field& field) {
    if (field.array == Array::none) return single(field);
    const std::uint32_t count = field.array == Array::fixed ? field.length : take<std::uint32_t>(field);
    if (!field.inner && field.basic == Basic::uint8) {
      const auto bytes = take(count, field);
      if (bytes.size() > most_) throw FormatError("the field " + field.name + " is longer than most_bytes");
      std::string encoded((bytes.size() + base64_in - 1) / base64_in * base64_out + 1, '\0');
      const int size =
          EVP_EncodeBlock(reinterpret_cast<unsigned char*>(encoded.data()),
                          reinterpret_cast<const unsigned char*>(bytes.data()), static_cast<int>(bytes.size()));
      encoded.resize(static_cast<std::size_t>(size));
      put("\"");
      put(encoded);
      return put("\"");
    }
    put("[");
    for (std::uint32_t i = 0; i < count; ++i) {
      if (i > 0) put(",");
      single(field);
    }
    put("]");
  }
  void single(const Field& field) {
    if (field.inner) return object(*field.inner);
    switch (field.basic) {
      case Basic::boolean:
        return put(take<std::uint8_t>(field) != 0 ? "true" : "false");
      case Basic::int8:
        return number<std::int8_t>(field);
      case Basic::uint8:
        return number<std::uint8_t>(field);
      case Basic::int16:
        return number<std::int16_t>(field);
      case Basic::uint16:
        return number<std::uint16_t>(field);
      case Basic::int32:
        return number<std::int32_t>(field);
      case Basic::uint32:
        return number<std::uint32_t>(field);
      case Basic::int64:
        return number<std::int64_t>(field);
      case Basic::uint64:
        return number<std::uint64_t>(field);
      case Basic::float32:
        return number<float>(field);
      case Basic::float64:
        return number<double>(field);
      case Basic::string: {
        const auto bytes = take(take<std::uint32_t>(field), field);
        return text({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
      }
      case Basic::time:
        return moment<std::uint32_t>(field);
      case Basic::duration:
        return moment<std::int32_t>(field);
    }
  }

  std::span<const std::byte> rest_;
  const std::size_t most_;
  std::string json_;
};

std::string MessageType::to_json(std::span<const std::byte> bytes, std::size_t most_bytes) const {
  return Reader(bytes, most_bytes).read(*structs_.at(name_));
}

}  // namespace iotcloud::drivers::ros
