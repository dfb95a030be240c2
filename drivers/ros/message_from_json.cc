#include <algorithm>
#include <limits>
#include <type_traits>
#include <utility>

#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/drivers/ros/message_type.h>

namespace iotcloud::drivers::ros {

/// Writes JSON as a message's bytes.
class MessageType::Writer {
 public:
  explicit Writer(std::size_t most_bytes) : most_(most_bytes) {}

  std::string write(const Struct& type, const nlohmann::json& json) {
    object(type, json, "");
    return std::move(bytes_);
  }

 private:
  [[noreturn]] static void refuse(const std::string& path, const std::string& why) {
    throw FormatError((path.empty() ? "the message" : "\"" + path + "\"") + " " + why);
  }
  void put(const void* bytes, std::size_t size) {
    if (bytes_.size() + size > most_)
      throw FormatError("the message is longer than " + std::to_string(most_) + " bytes (most_bytes)");
    bytes_.append(static_cast<const char*>(bytes), size);
  }
  template <typename Number>
  void put(Number number) {
    put(&number, sizeof number);
  }
  void put_size(std::size_t size, const std::string& path) {
    if (size > std::numeric_limits<std::uint32_t>::max()) refuse(path, "is too long");
    put(static_cast<std::uint32_t>(size));
  }
  void object(const Struct& type, const nlohmann::json& json, const std::string& path) {
    if (!json.is_null() && !json.is_object()) refuse(path, "is no JSON object, as " + type.name + " is");
    for (const auto& item : json.items()) {
      const std::string& name = item.key();
      if (std::none_of(type.fields.begin(), type.fields.end(),
                       [&](const Field& field) { return field.name == name; })) {
        std::string known;
        for (const Field& field : type.fields) known += (known.empty() ? "" : ", ") + field.name;
        refuse(path.empty() ? name : path + "." + name, "is no field of " + type.name + ", which has " + known);
      }
    }
    static const nlohmann::json nothing;
    for (const Field& field : type.fields) {
      const auto found = json.is_object() ? json.find(field.name) : json.end();
      const bool given = json.is_object() && found != json.end();
      value(field, given ? *found : nothing, given, path.empty() ? field.name : path + "." + field.name);
    }
  }
  void value(const Field& field, const nlohmann::json& json, bool given, const std::string& path) {
    if (field.array == Array::none) return single(field, json, given, path);
    if (!field.inner && field.basic == Basic::uint8 && json.is_string()) return base64(field, json, path);
    if (given && !json.is_array()) refuse(path, "is no JSON array");
    if (field.array == Array::fixed && given && json.size() != field.length)
      refuse(path, "has " + std::to_string(json.size()) + " values; it takes " + std::to_string(field.length));
    const std::size_t count = field.array == Array::fixed ? field.length : json.size();
    if (field.array == Array::any) put_size(count, path);
    static const nlohmann::json nothing;
    for (std::size_t i = 0; i < count; ++i)
      single(field, given ? json[i] : nothing, given, path + "[" + std::to_string(i) + "]");
  }
  void base64(const Field& field, const nlohmann::json& json, const std::string& path) {
    const auto& text = json.get_ref<const std::string&>();
    if (text.size() / base64_out * base64_in > most_) refuse(path, "is too long (most_bytes)");
    std::string bytes(text.size() / base64_out * base64_in + base64_in, '\0');
    const int size =
        EVP_DecodeBlock(reinterpret_cast<unsigned char*>(bytes.data()),
                        reinterpret_cast<const unsigned char*>(text.data()), static_cast<int>(text.size()));
    if (text.size() % base64_out != 0 || (size < 0 && !text.empty()))
      refuse(path, "is neither base64 nor an array of numbers");
    const auto padding = static_cast<std::size_t>(std::count(text.begin(), text.end(), '='));
    bytes.resize(text.empty() ? 0 : static_cast<std::size_t>(size) - std::min<std::size_t>(padding, 2));
    if (field.array == Array::fixed && bytes.size() != field.length)
      refuse(path, "has " + std::to_string(bytes.size()) + " bytes; it takes " + std::to_string(field.length));
    if (field.array == Array::any) put_size(bytes.size(), path);
    put(bytes.data(), bytes.size());
  }
  template <typename Number>
  void number(const nlohmann::json& json, bool given, const std::string& path) {
    if (!given) return put(Number{});
    if constexpr (std::is_floating_point_v<Number>) {
      if (json.is_null()) return put(std::numeric_limits<Number>::quiet_NaN());
      if (!json.is_number()) refuse(path, "is no number");
      put(json.get<Number>());
    } else {
      if (!json.is_number_integer()) refuse(path, "is no whole number");
      const bool fits = json.is_number_unsigned() ? std::in_range<Number>(json.get<std::uint64_t>())
                                                  : std::in_range<Number>(json.get<std::int64_t>());
      if (!fits) {
        refuse(path, "is " + json.dump() + "; it takes " + std::to_string(std::numeric_limits<Number>::min()) + " to " +
                         std::to_string(std::numeric_limits<Number>::max()));
      }
      put(json.get<Number>());
    }
  }
  template <typename Number>
  void moment(const nlohmann::json& json, bool given, const std::string& path) {
    if (given && (!json.is_object() || json.size() != 2 || !json.contains("secs") || !json.contains("nsecs")))
      refuse(path, "takes {\"secs\": 1, \"nsecs\": 2}");
    static const nlohmann::json nothing;
    for (const char* part : {"secs", "nsecs"}) number<Number>(given ? json[part] : nothing, given, path + "." + part);
  }
  void single(const Field& field, const nlohmann::json& json, bool given, const std::string& path) {
    if (++values_ > most_) throw FormatError("the message has too many values (most_bytes)");
    if (field.inner) {
      if (given && !json.is_object()) refuse(path, "is no JSON object, as " + field.inner->name + " is");
      return object(*field.inner, json, path);
    }
    switch (field.basic) {
      case Basic::boolean:
        if (given && !json.is_boolean()) refuse(path, "is neither true nor false");
        return put(static_cast<std::uint8_t>(given && json.get<bool>()));
      case Basic::int8:
        return number<std::int8_t>(json, given, path);
      case Basic::uint8:
        return number<std::uint8_t>(json, given, path);
      case Basic::int16:
        return number<std::int16_t>(json, given, path);
      case Basic::uint16:
        return number<std::uint16_t>(json, given, path);
      case Basic::int32:
        return number<std::int32_t>(json, given, path);
      case Basic::uint32:
        return number<std::uint32_t>(json, given, path);
      case Basic::int64:
        return number<std::int64_t>(json, given, path);
      case Basic::uint64:
        return number<std::uint64_t>(json, given, path);
      case Basic::float32:
        return number<float>(json, given, path);
      case Basic::float64:
        return number<double>(json, given, path);
      case Basic::string: {
        if (given && !json.is_string()) refuse(path, "is no text");
        const std::string text = given ? json.get<std::string>() : "";
        put_size(text.size(), path);
        return put(text.data(), text.size());
      }
      case Basic::time:
        return moment<std::uint32_t>(json, given, path);
      case Basic::duration:
        return moment<std::int32_t>(json, given, path);
    }
  }

  const std::size_t most_;
  std::size_t values_ = 0;  ///< some have no bytes
  std::string bytes_;
};

std::string MessageType::from_json(std::string_view json, std::size_t most_bytes) const {
  // JSON that is nested deeper than a message can be is refused before it is copied.
  const auto shallow = [](int depth, nlohmann::json::parse_event_t, nlohmann::json&) {
    if (static_cast<std::size_t>(depth) > 2 * deepest) throw FormatError("the JSON is nested too deeply");
    return true;
  };
  const auto read = nlohmann::json::parse(json, shallow, false);
  if (read.is_discarded() || !read.is_object()) throw FormatError("it is no JSON object");
  return Writer(most_bytes).write(*structs_.at(name_), read);
}

}  // namespace iotcloud::drivers::ros
