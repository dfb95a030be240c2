#include <algorithm>
#include <array>
#include <cctype>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string_view>

#include <fmt/format.h>
#include <zlib.h>

#include <iotcloud/check/bundle.h>

namespace iotcloud::check {

namespace {

constexpr std::size_t shortest_secret = 4;
constexpr const char* hidden = "***";
constexpr const char* pem_line = "-----";  ///< how the first and the last line of a file in PEM form begin

std::string without(std::string text, const std::string& secret) {
  for (auto at = text.find(secret); at != std::string::npos; at = text.find(secret, at + std::strlen(hidden)))
    text.replace(at, secret.size(), hidden);
  return text;
}

/// Everything between the lines of a private key in PEM form.
std::string without_private_keys(std::string text) {
  for (auto at = text.find("-----BEGIN "); at != std::string::npos; at = text.find("-----BEGIN ", at + 1)) {
    const auto head = text.find('\n', at);
    const auto line = text.substr(at, head == std::string::npos ? std::string::npos : head - at);
    if (line.find("PRIVATE KEY") == std::string::npos) continue;
    const auto end = text.find("-----END ", at);
    const auto last = end == std::string::npos ? text.size() : std::min(text.size(), text.find('\n', end));
    text.replace(at, last - at, "(a private key)");
  }
  return text;
}

/// Passwords in URLs: "amqp://user:password@host". A password may have '/', ',' and '@' in it.
std::string without_passwords_in_urls(const std::string& text) {
  std::string out;
  std::size_t from = 0;
  while (true) {
    const auto scheme = text.find("://", from);
    if (scheme == std::string::npos) break;
    const std::size_t start = scheme + 3;
    auto end = text.find_first_of(" \t\r\n\"'<>[]{}", start);
    if (end == std::string::npos) end = text.size();
    const auto host = std::string_view(text).substr(start, end - start);
    const auto at = host.rfind('@'), colon = host.find(':');
    out.append(text, from, start - from);
    if (at != std::string_view::npos && colon < at) {
      out.append(host.substr(0, colon + 1)).append(hidden).append(host.substr(at));
    } else {
      out.append(host);
    }
    from = end;
  }
  return out.append(text, from, std::string::npos);
}

/// Whether a key's value is a secret, by its name. A path to a file that holds one is none.
bool names_secret(std::string key) {
  std::transform(key.begin(), key.end(), key.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const char* place : {"_file", "_variable", "token_auth", "_keys"}) {
    if (key.find(place) != std::string::npos) return false;
  }
  for (const char* word : {"password", "passwd", "passphrase", "secret", "token", "credential", "apikey", "api_key",
                           "accesskey", "access_key", "privatekey", "private_key"}) {
    if (key.find(word) != std::string::npos) return true;
  }
  return false;
}

/// The word that ends before `end`, perhaps in quotes: the name of what stands behind. \param begins_line set to
/// whether nothing but blanks and dashes stands before it on its line
std::string name_before(const std::string& text, std::size_t end, bool& begins_line) {
  constexpr std::size_t longest = 100;
  const auto is_blank = [](char c) { return c == ' ' || c == '\t'; };
  while (end > 0 && is_blank(text[end - 1])) --end;
  if (end > 0 && (text[end - 1] == '"' || text[end - 1] == '\'')) --end;
  std::size_t begin = end;
  const auto is_of_name = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '.' || c == '-';
  };
  while (begin > 0 && end - begin < longest && is_of_name(text[begin - 1])) --begin;
  const auto before = begin == 0 ? std::string::npos : text.find_last_not_of(" \t-\"'", begin - 1);
  begins_line = before == std::string::npos || text[before] == '\n';
  return text.substr(begin, end - begin);
}

/// Where the lines end that are indented deeper than the one at `at`, which begin behind it: a text of YAML in lines of
/// its own.
std::size_t end_of_block(const std::string& text, std::size_t at) {
  const auto indent = [&](std::size_t line) {
    const auto first = text.find_first_not_of(' ', line);
    return (first == std::string::npos ? text.size() : first) - line;
  };
  const auto before = text.rfind('\n', at);
  const std::size_t own = indent(before == std::string::npos ? 0 : before + 1);
  std::size_t end = std::min(text.find('\n', at), text.size());
  while (end < text.size()) {
    const std::size_t line = end + 1;
    const std::size_t next = std::min(text.find('\n', line), text.size());
    const bool blank = text.find_first_not_of(" \t\r", line) >= next;
    if (!blank && indent(line) <= own) break;
    end = next;
  }
  return end;
}

/// Where the value ends that begins at `begin`: with its quote, or where a word does. \param of_line it is YAML's value
/// of a key that begins a line: without quotes it goes on to the end of the line, or in lines of its own
std::size_t end_of_value(const std::string& text, std::size_t begin, bool of_line) {
  const char quote = text[begin];
  if (quote != '"' && quote != '\'') {
    if (of_line && (quote == '|' || quote == '>')) return end_of_block(text, begin);
    if (of_line) return std::min(text.find_first_of("\r\n", begin), text.size());
    const auto end = text.find_first_of(" \t\r\n,}]\"'", begin);
    return end == std::string::npos ? text.size() : end;
  }
  std::size_t at = begin + 1;
  while (at < text.size() && text[at] != quote && text[at] != '\n')
    at += text[at] == '\\' && at + 1 < text.size() ? 2 : 1;
  return std::min(text.size(), at);
}

/// `password: x`, `"token": "x"`, `secret=x`: the value.
std::string without_named_secrets(const std::string& text) {
  std::string out;
  std::size_t from = 0;
  for (auto at = text.find_first_of(":="); at != std::string::npos; at = text.find_first_of(":=", at + 1)) {
    bool begins_line = false;
    if (at < from || !names_secret(name_before(text, at, begins_line))) continue;
    const auto begin = text.find_first_not_of(" \t", at + 1);
    if (begin == std::string::npos || text[begin] == '\n' || text[begin] == '\r') continue;
    const bool of_line = text[at] == ':' && begins_line && text[begin] != '{' && text[begin] != '[';
    const bool quoted = text[begin] == '"' || text[begin] == '\'';
    out.append(text, from, begin + (quoted ? 1 : 0) - from).append(hidden);
    from = end_of_value(text, begin, of_line);
  }
  return out.append(text, from, std::string::npos);
}

/// What stands behind a word: "Bearer", in a header.
std::string without_what_follows(const std::string& text, const std::string& word) {
  std::string out;
  std::size_t from = 0;
  for (auto at = text.find(word); at != std::string::npos; at = text.find(word, at + word.size())) {
    const std::size_t begin = at + word.size();
    if (begin < from) continue;
    auto end = text.find_first_of(" \t\r\n\"',", begin);
    if (end == std::string::npos) end = text.size();
    if (end == begin) continue;
    out.append(text, from, begin - from).append(hidden);
    from = end;
  }
  return out.append(text, from, std::string::npos);
}

/// Tokens (NAME.SECRET, whose secret is a run of hexadecimal digits), and what HTTP's headers have.
std::string without_tokens(const std::string& text) {
  std::string out;
  std::size_t from = 0;
  constexpr std::size_t least_digits = 32;
  const auto is_digit = [](char c) { return std::isxdigit(static_cast<unsigned char>(c)) != 0; };
  for (auto dot = text.find('.'); dot != std::string::npos; dot = text.find('.', dot + 1)) {
    std::size_t end = dot + 1;
    while (end < text.size() && is_digit(text[end])) ++end;
    if (end - dot - 1 < least_digits || dot == 0 || std::isspace(static_cast<unsigned char>(text[dot - 1])) != 0)
      continue;
    out.append(text, from, dot + 1 - from).append(hidden);
    from = end;
  }
  out.append(text, from, std::string::npos);
  return without_what_follows(without_what_follows(out, "Bearer "), "Basic ");
}

void put_octal(char* to, std::size_t width, std::uint64_t number) {
  const auto digits = fmt::format("{:0{}o}", number, width - 1);
  std::copy_n(digits.data(), std::min(width - 1, digits.size()), to);
}

/// A file's head in an archive (ustar).
std::array<char, 512> tar_head(const std::string& name, std::size_t size, std::int64_t time_s) {
  std::array<char, 512> head{};
  constexpr std::size_t longest = 100;
  if (name.size() > longest) throw std::invalid_argument("a name in the bundle is too long: " + name);
  std::memcpy(head.data(), name.data(), name.size());
  put_octal(head.data() + 100, 8, 0600);
  put_octal(head.data() + 108, 8, 0);
  put_octal(head.data() + 116, 8, 0);
  put_octal(head.data() + 124, 12, size);
  put_octal(head.data() + 136, 12, static_cast<std::uint64_t>(time_s));
  std::memset(head.data() + 148, ' ', 8);
  head[156] = '0';
  std::memcpy(head.data() + 257, "ustar\00000", 8);
  unsigned sum = 0;
  for (const char c : head) sum += static_cast<unsigned char>(c);
  put_octal(head.data() + 148, 7, sum);
  head[155] = ' ';
  return head;
}

std::string gzip(const std::string& bytes) {
  z_stream stream{};
  constexpr int with_gzip_head = 15 + 16;
  if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, with_gzip_head, 8, Z_DEFAULT_STRATEGY) != Z_OK)
    throw std::bad_alloc();
  std::string out(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  const int done = deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  if (done != Z_STREAM_END) throw std::runtime_error("the bundle cannot be compressed");
  return out;
}

}  // namespace

void Redactor::add_secret(std::string secret) {
  while (!secret.empty() && std::isspace(static_cast<unsigned char>(secret.back())) != 0) secret.pop_back();
  if (secret.size() < shortest_secret || std::find(secrets_.begin(), secrets_.end(), secret) != secrets_.end()) return;
  secrets_.push_back(std::move(secret));
  std::stable_sort(secrets_.begin(), secrets_.end(), [](const auto& a, const auto& b) { return a.size() > b.size(); });
}

void Redactor::add_secret_file(const std::string& file) {
  std::ifstream in(file);
  constexpr int most_lines = 10'000;
  std::string line;
  for (int i = 0; i < most_lines && std::getline(in, line); ++i) {
    if (!line.starts_with(pem_line)) add_secret(line);  // other keys have the same one
  }
}

std::string Redactor::redacted(std::string text) const {
  text = without_private_keys(std::move(text));  // while their first and last lines are there
  for (const auto& secret : secrets_) text = without(std::move(text), secret);
  return without_tokens(without_named_secrets(without_passwords_in_urls(text)));
}

std::string archive_of(const std::map<std::string, std::string>& files, std::int64_t time_s) {
  constexpr std::size_t block = 512;
  std::string tar;
  for (const auto& [name, text] : files) {
    const auto head = tar_head(name, text.size(), time_s);
    tar.append(head.data(), head.size()).append(text);
    tar.append((block - text.size() % block) % block, '\0');
  }
  tar.append(2 * block, '\0');
  return gzip(tar);
}

}  // namespace iotcloud::check
