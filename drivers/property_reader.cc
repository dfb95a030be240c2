#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>

#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers {

namespace {

[[noreturn]] void refuse(const std::string& name, const std::string& value, const std::string& wanted) {
  throw std::invalid_argument("property \"" + name + "\" is \"" + value + "\"; it takes " + wanted);
}

template <typename Number>
std::string in_text(Number number) {
  char buffer[32];
  const auto [end, status] = std::to_chars(buffer, buffer + sizeof buffer, number);
  return status == std::errc{} ? std::string(buffer, end) : std::string("?");
}

template <typename Number>
Number parse(const std::string& name, const std::string& value, Number min, Number max, const char* kind) {
  Number number{};
  const char* stop = value.data() + value.size();
  const auto [end, status] = std::from_chars(value.data(), stop, number);
  if (status != std::errc{} || end != stop || !(number >= min && number <= max)) {
    refuse(name, value, std::string(kind) + " from " + in_text(min) + " to " + in_text(max));
  }
  return number;
}

bool is_of_host(const std::string& name) {
  return name.starts_with("channel.") || name == "thread" || name == "hang_limit" || name == "isolation" ||
         name == "network" || name == "on_partition" || name == "lease";
}

std::string list(const auto& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

}  // namespace

const std::string* PropertyReader::find(const std::string& name) {
  known_.insert(name);
  const auto found = properties_.find(name);
  return found == properties_.end() ? nullptr : &found->second;
}

std::string PropertyReader::text(const std::string& name, const std::string& fallback) {
  const std::string* value = find(name);
  return value ? *value : fallback;
}

double PropertyReader::number(const std::string& name, double fallback, double min, double max) {
  const std::string* value = find(name);
  return value ? parse(name, *value, min, max, "a number") : fallback;
}

std::int64_t PropertyReader::integer(const std::string& name, std::int64_t fallback, std::int64_t min,
                                     std::int64_t max) {
  const std::string* value = find(name);
  return value ? parse(name, *value, min, max, "a whole number") : fallback;
}

bool PropertyReader::flag(const std::string& name, bool fallback) {
  return choice(name, fallback ? "true" : "false", {"true", "false"}) == "true";
}

std::string PropertyReader::choice(const std::string& name, const std::string& fallback,
                                   const std::vector<std::string>& choices) {
  std::string value = text(name, fallback);
  for (const std::string& choice : choices) {
    if (value == choice) return value;
  }
  refuse(name, value, "one of: " + list(choices));
}

void PropertyReader::finish() const {
  for (const auto& [name, value] : properties_) {
    if (is_of_host(name) || known_.contains(name)) continue;
    throw std::invalid_argument("unknown property \"" + name + "\"; this driver knows: " + list(known_) +
                                " (and channel.NAME.* for its channels)");
  }
}

std::vector<std::string> words_of(const std::string& list, char separator) {
  constexpr const char* blanks = " \t\r\n";
  std::vector<std::string> words;
  for (std::size_t at = 0; at <= list.size();) {
    const std::size_t end = std::min(list.find(separator, at), list.size());
    const auto first = list.find_first_not_of(blanks, at);
    if (first < end) words.push_back(list.substr(first, list.find_last_not_of(blanks, end - 1) - first + 1));
    at = end + 1;
  }
  return words;
}

}  // namespace iotcloud::drivers
