#include <algorithm>
#include <cctype>
#include <ostream>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <yaml-cpp/emitter.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/output/output.h>

namespace iotcloud::config::output {

namespace {

std::size_t width(const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](unsigned char c) { return (c & 0xc0) != 0x80; }));
}

/// Whether YAML reads the text as a string without quotes: it begins with a letter, has only harmless characters, and
/// is no word such as "no". Needed because the emitter does not quote "1e3" and "no", which readers take for a number
/// and a boolean.
bool plain_in_yaml(const std::string& text) {
  static const std::vector<std::string> words{"null", "true", "false", "yes", "no", "on", "off", "y", "n"};
  if (text.empty() || std::isalpha(static_cast<unsigned char>(text[0])) == 0) return false;
  std::string lower;
  for (const unsigned char c : text) {
    if (std::isalnum(c) == 0 && c != '-' && c != '_' && c != '.' && c != '/') return false;
    lower += static_cast<char>(std::tolower(c));
  }
  return std::find(words.begin(), words.end(), lower) == words.end();
}

void emit_text(YAML::Emitter& emitter, const std::string& text) {
  if (!plain_in_yaml(text)) emitter << YAML::DoubleQuoted;
  emitter << text;
}

void emit(YAML::Emitter& emitter, const nlohmann::ordered_json& value) {
  if (value.is_structured() && value.empty())
    emitter << YAML::Flow;  // block style would put an empty one on a line of its own
  if (value.is_object()) {
    emitter << YAML::BeginMap;
    for (const auto& [key, item] : value.items()) {
      emitter << YAML::Key;
      emit_text(emitter, key);
      emitter << YAML::Value;
      emit(emitter, item);
    }
    emitter << YAML::EndMap;
  } else if (value.is_array()) {
    emitter << YAML::BeginSeq;
    for (const auto& item : value) emit(emitter, item);
    emitter << YAML::EndSeq;
  } else if (value.is_string()) {
    emit_text(emitter, value.get_ref<const std::string&>());
  } else if (value.is_null()) {
    emitter << YAML::Null;
  } else {
    emitter << value.dump();  // the shortest text of this number
  }
}

}  // namespace

void print_table(std::ostream& out, const std::vector<std::string>& head,
                 const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
  widths.reserve(head.size());
  for (const auto& title : head) widths.push_back(width(title));
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], width(row[i]));
  const auto line = [&](const std::vector<std::string>& cells) {
    std::string text;
    for (std::size_t i = 0; i < cells.size(); ++i) text += cells[i] + std::string(widths[i] - width(cells[i]) + 2, ' ');
    text.erase(text.find_last_not_of(' ') + 1);
    out << text << '\n';
  };
  line(head);
  for (const auto& row : rows) line(row);
}

void print_yaml(std::ostream& out, const nlohmann::ordered_json& value) {
  YAML::Emitter emitter(out);
  emitter.SetNullFormat(YAML::LowerNull);
  emit(emitter, value);
  out << '\n';
}

void print_data(std::ostream& out, Format format, const nlohmann::ordered_json& json) {
  if (format == Format::yaml) return print_yaml(out, json);
  out << json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
}

void print(std::ostream& out, Format format, const std::vector<std::string>& head,
           const std::vector<std::vector<std::string>>& rows, const nlohmann::ordered_json& json) {
  if (format == Format::table) return print_table(out, head, rows);
  print_data(out, format, json);
}

std::int64_t now_ms() {
  return config::system_clock().wall_ms();
}

std::int64_t began_ms(std::chrono::seconds lasted) {
  return config::system_clock().wall_ms() - std::chrono::milliseconds(lasted).count();
}

std::string moment(std::int64_t time_ms) {
  if (time_ms <= 0) return "-";
  constexpr std::int64_t ms = 1000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(static_cast<std::time_t>(time_ms / ms)), time_ms % ms);
}

std::string age(std::int64_t since_ms, std::int64_t now_ms) {
  if (since_ms <= 0) return "-";
  constexpr std::int64_t minute = 60, hour = 60 * minute, day = 24 * hour;
  const auto seconds = std::max<std::int64_t>(0, (now_ms - since_ms) / 1000);
  if (seconds < 2 * minute) return fmt::format("{}s", seconds);
  if (seconds < 2 * hour) return fmt::format("{}m", seconds / minute);
  if (seconds < 2 * day) return fmt::format("{}h", seconds / hour);
  return fmt::format("{}d", seconds / day);
}

std::string printable(const std::string& text) {
  std::string out = text;
  std::replace_if(
      out.begin(), out.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }, ' ');
  return out;
}

}  // namespace iotcloud::config::output
