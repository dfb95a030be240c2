#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <set>
#include <utility>

#include <openssl/evp.h>

#include <iotcloud/drivers/ros/message_type.h>

namespace iotcloud::drivers::ros {

namespace {

constexpr std::size_t most_text = 1 << 20, most_types = 500, most_fields = 10'000;
constexpr std::size_t separator_size = 80;

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
      const auto refuse = [&] { throw DefinitionError("\"" + shown(type_text) + "\" is no array"); };
      if (begin >= end || *end != ']') refuse();
      const auto [stop, status] = std::from_chars(begin, end, field.length);
      if (status != std::errc{} || stop != end) refuse();
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

}  // namespace iotcloud::drivers::ros
