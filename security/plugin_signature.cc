#include <algorithm>
#include <cctype>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/security/plugin_signature.h>

namespace iotcloud::security {

namespace {

constexpr std::string_view head_word = "iotcloud-plugin ";
constexpr std::size_t longest_plugin_name = 64;

bool is_plugin_name(std::string_view name) {
  const auto good = [](unsigned char c) { return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '_'; };
  return !name.empty() && name.size() <= longest_plugin_name && std::all_of(name.begin(), name.end(), good);
}

}  // namespace

PluginSignature parse_plugin_signature(std::string_view text) {
  PluginSignature signature;
  signature.bytes = text;
  const auto end = text.find('\n');
  if (!text.starts_with(head_word) || end == std::string_view::npos || text.size() != end + 1 + signature_bytes)
    return signature;
  const std::string_view words = text.substr(head_word.size(), end - head_word.size());
  const auto space = std::min(words.find(' '), words.size());
  const std::string_view number = words.substr(std::min(space + 1, words.size()));
  const auto version = config::parse_number<std::uint64_t>(number).value_or(0);
  if (version == 0 || !is_plugin_name(words.substr(0, space))) return signature;
  signature.name = words.substr(0, space);
  signature.version = version;
  signature.head = text.substr(0, end + 1);
  signature.bytes = text.substr(end + 1);
  return signature;
}

bool is_plugin_signature(std::string_view text) {
  return text.size() <= most_plugin_signature_bytes && parse_plugin_signature(text).bytes.size() == signature_bytes;
}

std::string sign_plugin(const std::string& private_pem, const std::string& origin, std::string_view content,
                        const std::string& name, std::uint64_t version) {
  if (!is_plugin_name(name) || version == 0) {
    throw config::Error(
        fmt::format("\"{}\" {} cannot be a plugin's name and version: 1 to {} letters, digits, '.', '-' and '_', and a "
                    "number from 1",
                    name, version, longest_plugin_name));
  }
  std::string message = fmt::format("{}{} {}\n", head_word, name, version);
  const std::string head = message;
  message.append(content);
  return head + sign(private_pem, origin, message);
}

}  // namespace iotcloud::security
