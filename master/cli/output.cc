#include <algorithm>
#include <cctype>
#include <ostream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

namespace {

std::size_t width(const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](unsigned char c) { return (c & 0xc0) != 0x80; }));
}

/// Letters first, then what cannot change the meaning; everything else is quoted as JSON, which is YAML too.
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

std::string scalar(const nlohmann::ordered_json& value) {
  if (value.is_string() && plain_in_yaml(value.get_ref<const std::string&>())) return value.get<std::string>();
  return value.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

void print_block(std::ostream& out, const nlohmann::ordered_json& value, std::size_t indent, bool after_dash) {
  const std::string margin(indent, ' ');
  const auto is_block = [](const auto& v) { return v.is_structured() && !v.empty(); };
  bool first = after_dash;
  if (value.is_object() && !value.empty()) {
    for (const auto& [key, item] : value.items()) {
      out << (first ? "" : margin) << scalar(key) << ':';
      first = false;
      if (is_block(item)) {
        out << '\n';
        print_block(out, item, indent + 2, false);
      } else {
        out << ' ' << scalar(item) << '\n';
      }
    }
  } else if (value.is_array() && !value.empty()) {
    for (const auto& item : value) {
      out << (first ? "" : margin) << "- ";
      first = false;
      print_block(out, item, indent + 2, true);
    }
  } else {
    out << (first ? "" : margin) << scalar(value) << '\n';
  }
}

}  // namespace

void print_table(std::ostream& out, const std::vector<std::string>& head,
                 const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
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
  print_block(out, value, 0, false);
}

void print_data(std::ostream& out, Format format, const nlohmann::ordered_json& json) {
  if (format == Format::yaml) return print_yaml(out, json);
  out << json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
}

std::string age(std::int64_t since_ms, std::int64_t now_ms) {
  if (since_ms <= 0) return "-";
  const auto seconds = std::max<std::int64_t>(0, (now_ms - since_ms) / 1000);
  if (seconds < 120) return fmt::format("{}s", seconds);
  if (seconds < 120 * 60) return fmt::format("{}m", seconds / 60);
  if (seconds < 48 * 3600) return fmt::format("{}h", seconds / 3600);
  return fmt::format("{}d", seconds / 86400);
}

std::string printable(const std::string& text) {
  std::string out = text;
  std::replace_if(
      out.begin(), out.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }, ' ');
  return out;
}

std::string without_password(const std::string& url) {
  const auto scheme = url.find("://");
  const auto at = url.rfind('@');
  if (scheme == std::string::npos || at == std::string::npos) return url;
  const auto colon = url.find(':', scheme + 3);
  return colon < at ? url.substr(0, colon + 1) + "***" + url.substr(at) : url;
}

}  // namespace iotcloud::master::cli
