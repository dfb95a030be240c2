#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>
#include <set>
#include <type_traits>
#include <utility>

#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/drivers/ros/message_type.h>

namespace iotcloud::drivers::ros {

namespace {

constexpr std::size_t most_text = 1 << 20, most_types = 500, most_fields = 10'000, deepest = 32;
constexpr std::size_t separator_size = 80;
constexpr int base64_in = 3, base64_out = 4;

static_assert(std::endian::native == std::endian::little, "ROS 1 sends numbers so; another machine would turn them");

std::string_view without_blanks(std::string_view text) {
  const auto first = text.find_first_not_of(" \t\r");
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

/// Cuts off the next word.
std::string_view next_word(std::string_view& rest) {
  rest = without_blanks(rest);
  const auto end = rest.find_first_of(" \t");
  const std::string_view word = rest.substr(0, end);
  rest.remove_prefix(word.size());
  return word;
}

std::string_view next_line(std::string_view& rest) {
  const auto end = rest.find('\n');
  const std::string_view line = rest.substr(0, end);
  rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
  return line;
}

bool is_name(std::string_view text) {
  const auto letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
  return !text.empty() && letter(text.front()) &&
         std::all_of(text.begin(), text.end(), [&](char c) { return letter(c) || (c >= '0' && c <= '9') || c == '_'; });
}

/// "package/Type" in its two parts; empty ones: it is none.
std::pair<std::string, std::string> split_type(std::string_view type) {
  const auto slash = type.find('/');
  if (slash == std::string_view::npos || !is_name(type.substr(0, slash)) || !is_name(type.substr(slash + 1))) return {};
  return {std::string(type.substr(0, slash)), std::string(type.substr(slash + 1))};
}

std::string type_name(const std::string& name) {
  if (split_type(name).first.empty())
    throw DefinitionError("\"" + name + "\" is no type of messages, such as geometry_msgs/Twist");
  return name;
}

std::string shown(std::string_view line) {
  constexpr std::size_t most = 80;
  std::string text(line.substr(0, most));
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < ' ' || static_cast<unsigned char>(c) >= 0x7f) c = '?';
  }
  return text;
}

std::string md5(const std::string& text) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> bytes{};
  unsigned int size = 0;
  if (EVP_Digest(text.data(), text.size(), bytes.data(), &size, EVP_md5(), nullptr) != 1)
    throw std::runtime_error("OpenSSL computes no MD5, by which ROS compares types");
  std::string hex;
  for (unsigned int i = 0; i < size; ++i) {
    constexpr std::string_view digits = "0123456789abcdef";
    hex += digits[bytes[i] >> 4];
    hex += digits[bytes[i] & 0xf];
  }
  return hex;
}

}  // namespace

const MessageType::Basic* MessageType::basic_of(const std::string& type) {
  static const std::map<std::string, Basic> all{
      {"bool", Basic::boolean},  {"int8", Basic::int8},         {"uint8", Basic::uint8},     {"int16", Basic::int16},
      {"uint16", Basic::uint16}, {"int32", Basic::int32},       {"uint32", Basic::uint32},   {"int64", Basic::int64},
      {"uint64", Basic::uint64}, {"float32", Basic::float32},   {"float64", Basic::float64}, {"string", Basic::string},
      {"time", Basic::time},     {"duration", Basic::duration}, {"char", Basic::uint8},      {"byte", Basic::int8}};
  const auto found = all.find(type);
  return found == all.end() ? nullptr : &found->second;
}

MessageType::Field MessageType::read_field(const std::string& package, const std::string& type_text,
                                           const std::string& name) {
  Field field;
  field.name = name;
  const auto bracket = type_text.find('[');
  field.type = type_text.substr(0, bracket);
  std::string brackets;
  if (bracket != std::string::npos) {
    brackets = type_text.substr(bracket);
    field.array = Array::any;
    if (brackets != "[]") {
      field.array = Array::fixed;
      const char* begin = brackets.data() + 1;
      const char* end = brackets.data() + brackets.size() - 1;
      const auto [stop, status] = std::from_chars(begin, end, field.length);
      if (begin >= end || *end != ']' || status != std::errc{} || stop != end)
        throw DefinitionError("\"" + shown(type_text) + "\" is no array");
    }
  }
  if (const Basic* basic = basic_of(field.type)) {
    field.basic = *basic;
  } else {
    if (field.type == "Header") field.type = "std_msgs/Header";
    if (field.type.find('/') == std::string::npos) field.type = package + "/" + field.type;
    type_name(field.type);
  }
  field.type_text = field.type + brackets;
  return field;
}

MessageType::Struct MessageType::read_struct(const std::string& name, const std::string& text) {
  Struct type;
  std::set<std::string_view> names;
  type.name = name;
  type.text = text;
  const std::string package = split_type(name).first;
  std::string_view rest = text;
  while (!rest.empty()) {
    const std::string_view line = next_line(rest);
    const std::string_view clean = without_blanks(line.substr(0, line.find('#')));
    if (clean.empty()) continue;
    std::string_view words = clean;
    const std::string_view type_text = next_word(words);
    const auto equals = clean.find('=');
    if (equals != std::string_view::npos) {
      // A text goes on to the end of its line, comments and all.
      const std::string_view whole = type_text == "string" ? without_blanks(line) : clean;
      const auto at = whole.find('=');
      const std::string_view constant = without_blanks(whole.substr(type_text.size(), at - type_text.size()));
      if (!basic_of(std::string(type_text)) || !is_name(constant))
        throw DefinitionError(name + " has the line \"" + shown(line) + "\", which is no constant");
      type.constants.push_back(std::string(type_text) + " " + std::string(constant) + "=" +
                               std::string(without_blanks(whole.substr(at + 1))));
      continue;
    }
    const std::string_view field = next_word(words);
    if (!is_name(field) || !without_blanks(words).empty())
      throw DefinitionError(name + " has the line \"" + shown(line) + "\", which is no field");
    if (!names.insert(field).second) throw DefinitionError(name + " has two fields " + shown(field));
    type.fields.push_back(read_field(package, std::string(type_text), std::string(field)));
    if (type.fields.size() > most_fields) throw DefinitionError(name + " has too many fields");
  }
  return type;
}

MessageType MessageType::parse(const std::string& name, std::string_view text) {
  if (text.size() > most_text) throw DefinitionError("the definition of " + shown(name) + " is longer than 1 MiB");
  MessageType made;
  made.name_ = type_name(name);
  std::string at = name, part;
  std::size_t fields = 0;
  const auto add = [&] {
    if (made.structs_.size() >= most_types) throw DefinitionError("the definition of " + name + " has too many types");
    if (!part.empty()) part.pop_back();
    auto type = std::make_shared<Struct>(read_struct(at, part));
    fields += type->fields.size();
    if (fields > most_fields) throw DefinitionError("the definition of " + name + " has too many fields");
    made.structs_.try_emplace(at, std::move(type));
    part.clear();
  };
  while (!text.empty()) {
    const std::string_view line = next_line(text);
    if (line.size() >= separator_size && line.find_first_not_of('=') == std::string_view::npos) {
      add();
      std::string_view next = next_line(text);
      if (next_word(next) != "MSG:")
        throw DefinitionError("the definition of " + name + " has a separator that no \"MSG: TYPE\" follows");
      at = type_name(std::string(without_blanks(next)));
      continue;
    }
    part.append(line).push_back('\n');
  }
  add();
  made.connect(*made.structs_.at(name), 0);
  return made;
}

MessageType MessageType::load(const std::string& name, const std::vector<std::string>& folders) {
  MessageType made;
  made.name_ = type_name(name);
  std::vector<std::string> wanted{name};
  while (!wanted.empty()) {
    const std::string next = std::exchange(wanted.back(), {});
    wanted.pop_back();
    if (made.structs_.contains(next)) continue;
    const auto [package, type] = split_type(next);
    std::string searched;
    std::optional<std::string> text;
    for (const std::string& folder : folders) {
      searched += (searched.empty() ? "" : ", ") + folder;
      // A folder is that of all packages, or that of one, as in ROS_PACKAGE_PATH.
      for (const std::filesystem::path& place :
           {std::filesystem::path(folder) / package, std::filesystem::path(folder)}) {
        if (text || place.filename() != package) continue;
        std::ifstream in(place / "msg" / (type + ".msg"), std::ios::binary);
        if (in) text.emplace(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
      }
      if (text) break;
    }
    if (!text) {
      throw DefinitionError("there is no " + package + "/msg/" + type + ".msg in " +
                            (searched.empty() ? "any folder" : searched) +
                            "; install the package of these messages, or name its folder in the property msg_path");
    }
    const auto read = std::make_shared<Struct>(read_struct(next, *text));
    made.structs_[next] = read;
    for (const Field& field : read->fields) {
      if (!basic_of(field.type)) wanted.push_back(field.type);
    }
  }
  made.connect(*made.structs_.at(name), 0);
  return made;
}

void MessageType::connect(Struct& at, std::size_t depth) {
  if (at.connected) return;
  if (depth > deepest)
    throw DefinitionError("the definition of " + name_ + " has " + at.name + " within itself, or too deep");
  for (Field& field : at.fields) {
    if (basic_of(field.type)) continue;
    const auto found = structs_.find(field.type);
    if (found == structs_.end()) throw DefinitionError("the definition of " + name_ + " lacks that of " + field.type);
    connect(*found->second, depth + 1);
    field.inner = found->second.get();
  }
  at.connected = true;
}

std::string MessageType::md5sum_of(const Struct& type) {
  std::string text;
  for (const std::string& constant : type.constants) text += constant + "\n";
  for (const Field& field : type.fields)
    text += (field.inner ? md5sum_of(*field.inner) : field.type_text) + " " + field.name + "\n";
  if (!text.empty()) text.pop_back();
  return md5(text);
}

std::string MessageType::checksum() const {
  return md5sum_of(*structs_.at(name_));
}

void MessageType::collect(const Struct& at, std::vector<const Struct*>& found) const {
  for (const Field& field : at.fields) {
    if (!field.inner || std::find(found.begin(), found.end(), field.inner) != found.end()) continue;
    found.push_back(field.inner);
    collect(*field.inner, found);
  }
}

std::string MessageType::definition() const {
  const Struct& own = *structs_.at(name_);
  std::vector<const Struct*> inner;
  collect(own, inner);
  std::string text = own.text;
  for (const Struct* each : inner)
    text += "\n" + std::string(separator_size, '=') + "\nMSG: " + each->name + "\n" + each->text;
  return text;
}

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

std::string MessageType::to_json(std::span<const std::byte> bytes, std::size_t most_bytes) const {
  return Reader(bytes, most_bytes).read(*structs_.at(name_));
}

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
