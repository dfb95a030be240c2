#include <algorithm>
#include <exception>
#include <fstream>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/config/yaml/asked_keys.h>
#include <iotcloud/config/yaml/document.h>
#include <iotcloud/config/yaml/duration.h>
#include <iotcloud/config/yaml/errors.h>
#include <iotcloud/config/yaml/place.h>
#include <iotcloud/config/yaml/text.h>

namespace iotcloud::config {

namespace {

/// What all sections of a file share.
struct Document {
  std::string file;
  std::string source;    ///< the whole file
  bool keeping = false;  ///< all_errors() runs: errors are noted, not thrown
  bool runs_here = true;
  std::vector<ConfigError> errors;
  std::set<std::string> failed;  ///< dotted keys whose values are stand-ins

  void note(const ConfigError& error) {
    const auto is_it = [&](const ConfigError& other) { return std::string_view(other.what()) == error.what(); };
    if (errors.size() < internal::most_errors && std::none_of(errors.begin(), errors.end(), is_it)) {
      errors.push_back(error);
    }
  }
};

}  // namespace

struct YamlSection::Impl {
  YAML::Node node;  ///< a mapping
  std::shared_ptr<Document> document;
  std::string path;
  std::string pattern;     ///< as `path`, with `<name>` for names that the user chooses: see AskedKey
  bool stand_in = false;   ///< for a section that is missing or no mapping: its keys are not asked for
  bool cut_short = false;  ///< a part of its reader ended early: not all keys were asked for
  /// Keys that were asked for. All copies of a section share it, so that finish() sees what every reader asked for.
  std::set<std::string> asked;

  void note(const std::string& key, std::string kind, std::string fallback = "", std::string allowed = "");
  void note_required(const std::string& key, std::string kind, std::string allowed = "");
  /// Notes or throws an error of the value of a key. \param item of a sequence, as "[2]".
  void fail(const std::string& key, const ConfigError& error, const std::string& item = "") const;
  void fail_missing(const std::string& key, const std::string& example) const;
  /// A section inside this one.
  std::shared_ptr<Impl> inner(const YAML::Node& mapping, std::string inner_path, std::string inner_pattern) const;
};

namespace {

using internal::location;

std::string join(const std::string& path, const std::string& key) {
  return path.empty() ? key : path + "." + key;
}

const char* kind_of(const YAML::Node& node) {
  switch (node.Type()) {
    case YAML::NodeType::Null:
      return "nothing";
    case YAML::NodeType::Scalar:
      return "a single value";
    case YAML::NodeType::Sequence:
      return "a sequence";
    case YAML::NodeType::Map:
      return "a mapping";
    case YAML::NodeType::Undefined:
      break;
  }
  return "missing";
}

std::string list_of(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "\"" : ", \"") + word + "\"";
  return text;
}

std::string range_of(const auto& min, const auto& max) {
  return fmt::format("{} to {}", min, max);
}

template <typename Number>
bool parse_whole(const std::string& text, Number& value) {
  const auto number = parse_number<Number>(text);
  value = number.value_or(value);
  return number.has_value();
}

}  // namespace

void YamlSection::Impl::note(const std::string& key, std::string kind, std::string fallback, std::string allowed) {
  asked.insert(key);
  internal::note_asked({join(pattern, key), std::move(kind), std::move(fallback), std::move(allowed), false});
}

void YamlSection::Impl::note_required(const std::string& key, std::string kind, std::string allowed) {
  asked.insert(key);
  internal::note_asked({join(pattern, key), std::move(kind), "", std::move(allowed), true});
}

std::shared_ptr<YamlSection::Impl> YamlSection::Impl::inner(const YAML::Node& mapping, std::string inner_path,
                                                            std::string inner_pattern) const {
  auto impl = std::make_shared<Impl>();
  impl->document = document;
  impl->stand_in = stand_in;
  impl->path = std::move(inner_path);
  impl->pattern = std::move(inner_pattern);
  impl->node = mapping;
  return impl;
}

void YamlSection::Impl::fail(const std::string& key, const ConfigError& error, const std::string& item) const {
  if (!document->keeping) throw error;
  const std::string full = join(path, key);
  if (stand_in || (!item.empty() && !document->failed.insert(full + item).second)) return;
  if (document->failed.insert(full).second || !item.empty()) document->note(error);
}

void YamlSection::Impl::fail_missing(const std::string& key, const std::string& example) const {
  fail(key, ConfigError(location(document->file, node.Mark()), path, "the key \"" + key + "\" is missing",
                        "add " + example));
}

YamlSection YamlSection::parse(std::string_view text, const std::string& name) {
  YamlSection top = parse_keeping(text, name);
  if (!top.impl_->document->errors.empty()) throw together(std::exchange(top.impl_->document->errors, {}));
  return top;
}

YamlSection YamlSection::parse_keeping(std::string_view text, const std::string& name) {
  auto impl = std::make_shared<Impl>();
  impl->document = std::make_shared<Document>();
  impl->document->file = name;
  impl->document->source = internal::checked_text(text, name);
  impl->node = internal::read_document(impl->document->source, name, impl->document->errors);
  if (!impl->node.IsMap()) {
    throw ConfigError({name, 1, 1}, "", std::string("a mapping is expected at the top, not ") + kind_of(impl->node),
                      "write lines of the form \"key: value\"");
  }
  return YamlSection(std::move(impl));
}

namespace {

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text(internal::most_text_bytes + 1, '\0');  // one byte more than allowed is enough to refuse a file
  if (file) file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (!file.eof() && file.fail()) {
    throw ConfigError({path, 0, 0}, "", "this file cannot be read", "check its name and permissions");
  }
  text.resize(static_cast<std::size_t>(file.gcount()));
  return text;
}

/// The value of a key, or an undefined node; a key without a value counts as missing.
YAML::Node lookup(const YAML::Node& node, const std::string& key) {
  const YAML::Node value = node[key];
  if (!value || value.IsNull()) return YAML::Node(YAML::NodeType::Undefined);
  return value;
}

/// The node of the key itself, for its place. \param key of the mapping, or after dots of one below it
YAML::Node key_node(const YAML::Node& mapping, const std::string& key) {
  for (const auto& entry : mapping) {
    if (entry.first.Scalar() == key) return entry.first;
  }
  const std::size_t dot = key.find('.');
  if (dot == std::string::npos) return YAML::Node(YAML::NodeType::Undefined);
  const YAML::Node below = lookup(mapping, key.substr(0, dot));
  if (!below.IsMap()) return YAML::Node(YAML::NodeType::Undefined);
  return key_node(below, key.substr(dot + 1));
}

}  // namespace

YamlSection YamlSection::load_file(const std::string& path) {
  return parse(text_of(path), path);
}

void YamlSection::read_file(const std::string& path, const std::function<void(YamlSection&)>& read) {
  read_text(text_of(path), path, read);
}

void YamlSection::read_text(std::string_view text, const std::string& name,
                            const std::function<void(YamlSection&)>& read) {
  YamlSection top = parse_keeping(text, name);
  top.all_errors([&] { read(top); });
}

void YamlSection::all_errors(const std::function<void()>& read) const {
  Document& document = *impl_->document;
  if (document.keeping) {
    read();
    return;
  }
  document.keeping = true;
  std::exception_ptr other;
  try {
    part(read);
  } catch (...) {
    other = std::current_exception();
  }
  document.keeping = false;
  document.failed.clear();
  auto errors = std::exchange(document.errors, {});
  if (errors.empty()) {
    if (other) std::rethrow_exception(other);
    return;
  }
  // `other` comes from a stand-in.
  std::stable_sort(errors.begin(), errors.end(), [](const ConfigError& a, const ConfigError& b) {
    return std::pair(a.where().line, a.where().column) < std::pair(b.where().line, b.where().column);
  });
  throw together(errors);
}

bool YamlSection::has_errors() const {
  return !impl_->document->errors.empty();
}

void YamlSection::is_for_another_machine() const {
  impl_->document->runs_here = false;
}

bool YamlSection::runs_here() const {
  return impl_->document->runs_here;
}

bool YamlSection::is_wrong(const std::string& key) const {
  return impl_->document->failed.contains(join(impl_->path, key));
}

void YamlSection::part(const std::function<void()>& read) const {
  try {
    read();
  } catch (const ConfigError& error) {
    impl_->cut_short = true;
    refuse(error);
  }
}

void YamlSection::refuse(const std::string& key, const std::string& problem, const std::string& remedy) const {
  refuse(error(key, problem, remedy));
}

void YamlSection::refuse(const ConfigError& error) const {
  Document& document = *impl_->document;
  if (!document.keeping) throw error;
  if (!impl_->stand_in && !document.failed.contains(error.key())) document.note(error);
}

bool YamlSection::has(const std::string& key) const {
  return lookup(impl_->node, key).IsDefined();
}

Location YamlSection::where(const std::string& key) const {
  const YAML::Node found = key.empty() ? YAML::Node(YAML::NodeType::Undefined) : key_node(impl_->node, key);
  return location(impl_->document->file, found.IsDefined() ? found.Mark() : impl_->node.Mark());
}

const std::string& YamlSection::path() const {
  return impl_->path;
}

ConfigError YamlSection::error(const std::string& key, const std::string& problem, const std::string& remedy) const {
  return ConfigError(where(key), key.empty() ? impl_->path : join(impl_->path, key), problem, remedy);
}

ConfigError YamlSection::error_within(const std::string& key, std::size_t offset, const std::string& problem) const {
  const YAML::Node value = lookup(impl_->node, key);
  if (!value.IsDefined() || !value.IsScalar()) return error(key, problem);
  const Location begin = location(impl_->document->file, value.Mark());
  return ConfigError(internal::place_in_scalar(impl_->document->source, begin, value.Scalar(), offset),
                     join(impl_->path, key), problem, "");
}

std::optional<std::string> YamlSection::optional_string(const std::string& key) {
  impl_->note(key, "text");
  const YAML::Node value = lookup(impl_->node, key);
  if (!value.IsDefined()) return std::nullopt;
  if (!value.IsScalar()) {
    impl_->fail(key, error(key, std::string("a single value is expected here, not ") + kind_of(value), ""));
    return std::nullopt;
  }
  return value.Scalar();
}

std::string YamlSection::require_string(const std::string& key) {
  impl_->note_required(key, "text");
  auto value = optional_string(key);
  if (!value) impl_->fail_missing(key, "\"" + key + ": ...\"");
  if (value && value->empty()) impl_->fail(key, error(key, "this must not be empty", ""));
  return value.value_or("");
}

std::string YamlSection::string_or(const std::string& key, const std::string& fallback) {
  impl_->note(key, "text", fallback);
  return optional_string(key).value_or(fallback);
}

std::int64_t YamlSection::int_or(const std::string& key, std::int64_t fallback, std::int64_t min, std::int64_t max) {
  impl_->note(key, "whole number", std::to_string(fallback), range_of(min, max));
  const auto text = optional_string(key);
  if (!text) return fallback;
  std::int64_t value = 0;
  if (!parse_whole(*text, value) || value < min || value > max) {
    impl_->fail(key,
                error(key, "\"" + *text + "\" does not fit",
                      "a whole number from " + std::to_string(min) + " to " + std::to_string(max) + " is expected"));
    return fallback;
  }
  return value;
}

std::int64_t YamlSection::require_int(const std::string& key, std::int64_t min, std::int64_t max) {
  impl_->note_required(key, "whole number", range_of(min, max));
  static_cast<void>(require_string(key));
  return int_or(key, min, min, max);
}

double YamlSection::double_or(const std::string& key, double fallback, double min, double max) {
  impl_->note(key, "number", fmt::format("{}", fallback), range_of(min, max));
  const auto text = optional_string(key);
  if (!text) return fallback;
  double value = 0;
  if (!parse_whole(*text, value) || !(value >= min && value <= max)) {
    impl_->fail(
        key, error(key, "\"" + *text + "\" does not fit", fmt::format("a number from {} to {} is expected", min, max)));
    return fallback;
  }
  return value;
}

bool YamlSection::bool_or(const std::string& key, bool fallback) {
  impl_->note(key, "true or false", fallback ? "true" : "false");
  const auto text = optional_string(key);
  if (!text) return fallback;
  if (*text == "true" || *text == "yes" || *text == "on") return true;
  if (*text == "false" || *text == "no" || *text == "off") return false;
  impl_->fail(key, error(key, "\"" + *text + "\" does not fit", "true or false is expected"));
  return fallback;
}

std::chrono::microseconds YamlSection::duration_or(const std::string& key, std::chrono::microseconds fallback) {
  impl_->note(key, "duration", internal::duration_text(fallback));
  const auto text = optional_string(key);
  if (!text) return fallback;
  const auto value = parse_duration(*text);
  if (!value) {
    impl_->fail(
        key, error(key, "\"" + *text + "\" is not a duration", "write a number and a unit: 250ms, 2s, 5m, 1h or 10us"));
    return fallback;
  }
  return *value;
}

std::string YamlSection::choice_or(const std::string& key, const std::string& fallback,
                                   const std::vector<std::string>& choices) {
  impl_->note(key, "choice", fallback, list_of(choices));
  const auto value = optional_string(key);
  if (!value) return fallback;
  if (std::find(choices.begin(), choices.end(), *value) == choices.end()) {
    const std::string guess = nearest(*value, choices);
    impl_->fail(key, error(key, "\"" + *value + "\" is not known",
                           (guess.empty() ? "" : "did you mean \"" + guess + "\"? ") + std::string("use one of ") +
                               list_of(choices)));
    return fallback;
  }
  return *value;
}

std::string YamlSection::require_choice(const std::string& key, const std::vector<std::string>& choices) {
  impl_->note_required(key, "choice", list_of(choices));
  static_cast<void>(require_string(key));
  return choice_or(key, "", choices);
}

std::vector<std::string> YamlSection::strings_or(const std::string& key, const std::vector<std::string>& fallback) {
  impl_->note(key, "list of texts", list_of(fallback));
  const YAML::Node value = lookup(impl_->node, key);
  if (!value.IsDefined()) return fallback;
  if (value.IsScalar()) return {value.Scalar()};
  if (!value.IsSequence()) {
    impl_->fail(key, error(key, std::string("a sequence is expected here, not ") + kind_of(value), "[a, b]"));
    return fallback;
  }
  std::vector<std::string> strings;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const YAML::Node item = value[i];
    if (!item.IsScalar()) {
      impl_->fail(key,
                  ConfigError(location(impl_->document->file, item.Mark()), join(impl_->path, key),
                              std::string("single values are expected in this sequence, not ") + kind_of(item), ""),
                  "[" + std::to_string(i) + "]");
      continue;
    }
    strings.push_back(item.Scalar());
  }
  return strings;
}

std::vector<std::string> YamlSection::require_strings(const std::string& key) {
  impl_->note_required(key, "list of texts");
  auto strings = strings_or(key, {});
  if (!has(key)) {
    impl_->fail_missing(key, "\"" + key + ": [...]\"");
  } else if (strings.empty()) {
    impl_->fail(key, error(key, "this must not be empty", ""));
  }
  return strings;
}

std::vector<YamlSection::Item> YamlSection::require_items(const std::string& key) {
  impl_->note_required(key, "list of texts and mappings");
  const YAML::Node value = lookup(impl_->node, key);
  std::vector<Item> items;
  if (!value.IsDefined()) {
    impl_->fail_missing(key, "\"" + key + ": [...]\"");
    return items;
  }
  if (value.IsScalar()) return {Item{value.Scalar(), std::nullopt}};
  if (!value.IsSequence()) {
    impl_->fail(key, error(key, std::string("a sequence is expected here, not ") + kind_of(value), "[a, b]"));
    return items;
  }
  const std::string path = join(impl_->path, key);
  for (std::size_t i = 0; i < value.size(); ++i) {
    const YAML::Node item = value[i];
    const std::string item_path = path + "[" + std::to_string(i) + "]";
    if (item.IsScalar()) {
      items.push_back({item.Scalar(), std::nullopt});
    } else if (item.IsMap()) {
      items.push_back({"", YamlSection(impl_->inner(item, item_path, join(impl_->pattern, key) + "[]"))});
    } else {
      impl_->fail(key,
                  ConfigError(location(impl_->document->file, item.Mark()), item_path,
                              std::string("a single value or a mapping is expected here, not ") + kind_of(item), ""),
                  "[" + std::to_string(i) + "]");
    }
  }
  if (items.empty()) impl_->fail(key, error(key, "this must not be empty", ""));
  return items;
}

std::map<std::string, std::string> YamlSection::string_map(const std::string& key) {
  impl_->note(key, "mapping of texts");
  const YAML::Node value = lookup(impl_->node, key);
  std::map<std::string, std::string> map;
  if (!value.IsDefined()) return map;
  if (!value.IsMap()) {
    impl_->fail(key, error(key, std::string("a mapping is expected here, not ") + kind_of(value), ""));
    return map;
  }
  for (const auto& entry : value) {
    if (!entry.second.IsScalar()) {
      impl_->fail(key,
                  ConfigError(location(impl_->document->file, entry.second.Mark()),
                              join(join(impl_->path, key), entry.first.Scalar()),
                              std::string("a single value is expected here, not ") + kind_of(entry.second), ""),
                  "." + entry.first.Scalar());
      continue;
    }
    map[entry.first.Scalar()] = entry.second.Scalar();
  }
  return map;
}

std::vector<std::string> YamlSection::names() const {
  std::vector<std::string> names;
  for (const auto& entry : impl_->node) names.push_back(entry.first.Scalar());
  return names;
}

bool YamlSection::is_list(const std::string& key) const {
  const YAML::Node value = lookup(impl_->node, key);
  return value.IsDefined() && value.IsSequence();
}

bool YamlSection::is_mapping(const std::string& key) const {
  const YAML::Node value = lookup(impl_->node, key);
  return value.IsDefined() && value.IsMap();
}

std::vector<std::pair<std::string, YamlSection>> YamlSection::sections(const std::string& key) {
  impl_->note(key, "mapping of mappings");
  const YAML::Node value = lookup(impl_->node, key);
  std::vector<std::pair<std::string, YamlSection>> result;
  if (!value.IsDefined()) return result;
  if (!value.IsMap()) {
    impl_->fail(key, error(key, std::string("a mapping is expected here, not ") + kind_of(value), ""));
    return result;
  }
  for (const auto& entry : value) {
    const std::string& name = entry.first.Scalar();
    const std::string path = join(join(impl_->path, key), name);
    if (!entry.second.IsMap()) {
      impl_->fail(key,
                  ConfigError(location(impl_->document->file, entry.first.Mark()), path,
                              std::string("a mapping is expected here, not ") + kind_of(entry.second), ""),
                  "." + name);
      continue;
    }
    result.emplace_back(name, YamlSection(impl_->inner(entry.second, path, join(join(impl_->pattern, key), "<name>"))));
  }
  return result;
}

std::vector<YamlSection> YamlSection::section_list(const std::string& key) {
  impl_->note(key, "list of mappings");
  const YAML::Node value = lookup(impl_->node, key);
  std::vector<YamlSection> result;
  if (!value.IsDefined()) return result;
  const auto add = [&](const YAML::Node& item, const std::string& path) {
    if (!item.IsMap()) {
      impl_->fail(key,
                  ConfigError(location(impl_->document->file, item.Mark()), path,
                              std::string("a mapping is expected here, not ") + kind_of(item), ""),
                  path.substr(path.rfind('[') == std::string::npos ? path.size() : path.rfind('[')));
      return;
    }
    result.push_back(YamlSection(impl_->inner(item, path, join(impl_->pattern, key) + "[]")));
  };
  const std::string path = join(impl_->path, key);
  if (value.IsSequence()) {
    for (std::size_t i = 0; i < value.size(); ++i) add(value[i], path + "[" + std::to_string(i) + "]");
  } else {
    add(value, path);
  }
  return result;
}

std::optional<YamlSection> YamlSection::optional_section(const std::string& key) {
  impl_->note(key, "mapping");
  const YAML::Node value = lookup(impl_->node, key);
  if (!value.IsDefined()) return std::nullopt;
  if (!value.IsMap()) {
    impl_->fail(key, error(key, std::string("a mapping is expected here, not ") + kind_of(value), ""));
    return std::nullopt;
  }
  return YamlSection(impl_->inner(value, join(impl_->path, key), join(impl_->pattern, key)));
}

YamlSection YamlSection::require_section(const std::string& key) {
  impl_->note_required(key, "mapping");
  auto section = optional_section(key);
  if (section) return *section;
  impl_->fail_missing(key, "\"" + key + ":\" and what belongs below it");
  auto stand_in = impl_->inner(YAML::Node(YAML::NodeType::Map), join(impl_->path, key), join(impl_->pattern, key));
  stand_in->stand_in = true;
  return YamlSection(std::move(stand_in));
}

void YamlSection::finish() const {
  if (impl_->cut_short) return;
  const std::vector<std::string> known(impl_->asked.begin(), impl_->asked.end());
  all_errors([&] {
    for (const auto& entry : impl_->node) {
      const std::string& key = entry.first.Scalar();
      if (impl_->asked.contains(key)) continue;
      const std::string guess = nearest(key, known);
      refuse(key, "unknown key", guess.empty() ? "known are " + list_of(known) : "did you mean \"" + guess + "\"?");
    }
  });
}

}  // namespace iotcloud::config
