#include <algorithm>
#include <array>
#include <functional>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/utf8.h>
#include <iotcloud/gateway/provisioning/template.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

namespace {

using Fit = std::optional<std::string> (*)(const std::string&);

bool is_alphanumeric(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
}
bool is_of_word(char c) {
  return is_alphanumeric(c) || c == '.' || c == '_' || c == '-';
}
bool is_control(char c) {
  return static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
}

std::optional<std::string> as_word(const std::string& value) {
  constexpr std::size_t longest = 200;
  const bool good = !value.empty() && value.size() <= longest && value.front() != '.' && value.front() != '-' &&
                    std::all_of(value.begin(), value.end(), is_of_word);
  return good ? std::optional(value) : std::nullopt;
}

std::optional<std::string> as_name(const std::string& value) {
  constexpr std::size_t longest = 120, of_the_sum = 8;
  if (value.empty()) return std::nullopt;
  if (value.size() <= longest && as_word(value)) return value;
  std::string name = value.substr(0, longest - of_the_sum - 1);
  std::replace_if(
      name.begin(), name.end(), [](char c) { return !is_of_word(c); }, '-');
  if (!is_alphanumeric(name.front())) name.front() = 'x';
  return name + "-" + security::sha256_hex(value).substr(0, of_the_sum);
}

std::optional<std::string> as_host(const std::string& value) {
  constexpr std::size_t longest = 253;
  std::array<unsigned char, sizeof(in6_addr)> address{};
  const std::string bare = value.starts_with('[') && value.ends_with(']') ? value.substr(1, value.size() - 2) : value;
  if (inet_pton(AF_INET6, bare.c_str(), address.data()) == 1) return "[" + bare + "]";
  const bool good = !value.empty() && value.size() <= longest && is_alphanumeric(value.front()) &&
                    std::all_of(value.begin(), value.end(), is_of_word) && value.find("..") == std::string::npos;
  return good ? std::optional(value) : std::nullopt;
}

std::optional<std::string> as_number(const std::string& value) {
  constexpr std::size_t longest = 32;
  const std::size_t sign = value.starts_with('-') ? 1 : 0;
  const auto digits = std::string_view(value).substr(sign);
  const bool good =
      !digits.empty() && value.size() <= longest && std::count(digits.begin(), digits.end(), '.') <= 1 &&
      digits.front() != '.' && digits.back() != '.' &&
      std::all_of(digits.begin(), digits.end(), [](char c) { return (c >= '0' && c <= '9') || c == '.'; });
  return good ? std::optional(value) : std::nullopt;
}

std::optional<std::string> as_path(const std::string& value) {
  constexpr std::size_t longest = 200;
  const auto fits = [](char c) { return is_of_word(c) || std::string_view("/:@+").find(c) != std::string_view::npos; };
  const bool good = value.starts_with("/dev/") && value.size() <= longest && value.size() > 5 &&
                    value.find("..") == std::string::npos && std::all_of(value.begin(), value.end(), fits);
  return good ? std::optional(value) : std::nullopt;
}

std::optional<std::string> as_topic(const std::string& value) {
  constexpr std::size_t longest = 1024;
  const auto is_bad = [](char c) {
    return is_control(c) || std::string_view("#+,=").find(c) != std::string_view::npos;
  };
  const bool good = !value.empty() && value.size() <= longest && value.front() != '$' && value.front() != ' ' &&
                    value.back() != ' ' && std::none_of(value.begin(), value.end(), is_bad) && config::is_utf8(value);
  return good ? std::optional(value) : std::nullopt;
}

std::optional<std::string> as_topics(const std::string& value) {
  std::string list;
  for (std::size_t at = 0; at <= value.size();) {
    const std::size_t end = std::min(value.find(',', at), value.size());
    std::string item = value.substr(at, end - at);
    at = end + 1;
    item.erase(0, std::min(item.find_first_not_of(' '), item.size()));
    const auto equals = item.find('=');
    if (equals == std::string::npos || !as_topic(item.substr(0, equals)) || !as_word(item.substr(equals + 1)))
      return std::nullopt;
    list += (list.empty() ? "" : ", ") + item;
  }
  return list;
}

std::optional<std::string> as_text(const std::string& value) {
  constexpr std::size_t longest = 256;
  const bool good =
      value.size() <= longest && std::none_of(value.begin(), value.end(), is_control) && config::is_utf8(value);
  return good ? std::optional(value) : std::nullopt;
}

struct Form {
  std::string_view name;
  Fit fit;
};
constexpr Form forms[] = {{"word", as_word}, {"name", as_name},   {"host", as_host},     {"number", as_number},
                          {"path", as_path}, {"topic", as_topic}, {"topics", as_topics}, {"text", as_text}};

const Form* form_named(std::string_view name) {
  const auto* found =
      std::find_if(std::begin(forms), std::end(forms), [&](const Form& form) { return form.name == name; });
  return found == std::end(forms) ? nullptr : found;
}

}  // namespace

std::optional<std::string> in_form(std::string_view form, const std::string& value) {
  const Form* known = form_named(form);
  return known == nullptr ? std::nullopt : known->fit(value);
}

Template Template::parse(std::string_view text) {
  Template made;
  std::string* into = &made.before_;
  for (std::size_t at = 0; at < text.size(); ++at) {
    const char c = text[at];
    const bool twice = at + 1 < text.size() && text[at + 1] == c;
    if ((c == '{' || c == '}') && twice) {
      *into += c;
      ++at;
      continue;
    }
    if (c == '}')
      throw config::Error(fmt::format("\"{}\" has a \"}}\" that ends no place; write \"}}}}\" for one", text));
    if (c != '{') {
      *into += c;
      continue;
    }
    const auto end = text.find('}', at);
    if (end == std::string_view::npos)
      throw config::Error(fmt::format("\"{}\" has a \"{{\" without its \"}}\"; write \"{{{{\" for one", text));
    const std::string inside(text.substr(at + 1, end - at - 1));
    const auto colon = inside.find(':');
    Place place{inside.substr(0, colon), colon == std::string::npos ? "word" : inside.substr(colon + 1), ""};
    if (!as_word(place.attribute))
      throw config::Error(
          fmt::format("\"{}\" has a place \"{{{}}}\", whose attribute has no name of letters, digits, "
                      "\".\", \"_\" and \"-\"",
                      text, inside));
    if (form_named(place.form) == nullptr) {
      std::vector<std::string_view> names;
      for (const Form& form : forms) names.push_back(form.name);
      throw config::Error(
          fmt::format("\"{}\" has a place of the form \"{}\"; there are {}", text, place.form, fmt::join(names, ", ")));
    }
    made.places_.push_back(std::move(place));
    into = &made.places_.back().after;
    at = end;
  }
  return made;
}

Template::Filled Template::fill(const std::map<std::string, std::string>& attributes) const {
  Filled filled;
  std::string text = before_;
  for (const Place& place : places_) {
    const auto found = attributes.find(place.attribute);
    if (found == attributes.end()) {
      filled.missing = place.attribute;
      return filled;
    }
    const auto fitting = in_form(place.form, found->second);
    if (!fitting) {
      filled.problem = fmt::format("its attribute \"{}\" is no {}", place.attribute, place.form);
      return filled;
    }
    text += *fitting + place.after;
    if (text.size() > longest_filled) {
      filled.problem = fmt::format("its attribute \"{}\" is too long", place.attribute);
      return filled;
    }
  }
  filled.text = std::move(text);
  return filled;
}

}  // namespace iotcloud::gateway
