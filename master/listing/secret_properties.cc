#include <algorithm>
#include <cctype>

#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master {

namespace {

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// Whether the text contains the word as a word of its own: "key", but not in "monkey".
bool has_word(const std::string& text, const std::string& word) {
  const auto is_letter = [&](std::size_t at) {
    return at < text.size() && std::isalpha(static_cast<unsigned char>(text[at])) != 0;
  };
  for (auto at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    if ((at == 0 || !is_letter(at - 1)) && !is_letter(at + word.size())) return true;
  }
  return false;
}

/// "rtsp://admin:password@camera/stream", also among several URLs. A password may contain a '/', so some other URLs
/// count too ("http://camera:80/a@b"): rather one too many.
bool has_url_with_password(const std::string& value) {
  return value.find("://") != std::string::npos && without_password(value) != value;
}

}  // namespace

bool is_secret(const std::string& key, const std::string& value) {
  const std::string name = lower_case(key);
  for (const char* part :
       {"password", "passwd", "passphrase", "secret", "token", "credential", "apikey", "accesskey", "privatekey"}) {
    if (name.find(part) != std::string::npos) return true;
  }
  return has_word(name, "key") || has_url_with_password(value);
}

std::string without_password(const std::string& url) {
  const auto scheme = url.find("://");
  const auto start = scheme == std::string::npos ? 0 : scheme + 3;
  // The last '@' of all: a password may contain one, and a '/' too.
  const auto at = url.rfind('@');
  if (at == std::string::npos || at < start) return url;
  const auto colon = url.find(':', start);
  return colon < at ? url.substr(0, colon + 1) + "***" + url.substr(at) : url;
}

}  // namespace iotcloud::master
