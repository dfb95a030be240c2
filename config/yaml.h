#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/error.h>

namespace iotcloud::config {

/// One mapping of a YAML file, read strictly: every key is asked for, or finish() reports it as unknown with the
/// nearest known key. Wrong types, missing keys and values out of range throw ConfigError with file, line, column, the
/// dotted key and what would be right. Duplicate keys are errors. Not thread safe; cheap to copy (shares the document).
class Section {
 public:
  /// \throws ConfigError when the file cannot be read, is not YAML, or is not a mapping at the top. Refused, too, is
  /// what no editor writes: other than UTF-8, control characters, more than 4 MiB, 32 levels or 500'000 values.
  static Section load_file(const std::string& path);
  /// \param name stands for the file in messages.
  static Section parse(std::string_view text, const std::string& name);

  bool has(const std::string& key) const;

  std::string require_string(const std::string& key);
  std::string string_or(const std::string& key, const std::string& fallback);
  std::optional<std::string> optional_string(const std::string& key);
  std::int64_t int_or(const std::string& key, std::int64_t fallback, std::int64_t min, std::int64_t max);
  std::int64_t require_int(const std::string& key, std::int64_t min, std::int64_t max);
  double double_or(const std::string& key, double fallback, double min, double max);
  bool bool_or(const std::string& key, bool fallback);
  /// "250ms", "2s", "5m", "1h", "10us"; a bare number is refused, its unit would be a guess.
  std::chrono::microseconds duration_or(const std::string& key, std::chrono::microseconds fallback);
  /// One of `choices`, or the error lists them.
  std::string choice_or(const std::string& key, const std::string& fallback, const std::vector<std::string>& choices);
  std::string require_choice(const std::string& key, const std::vector<std::string>& choices);

  /// A sequence of strings; a single string counts as a sequence of one.
  std::vector<std::string> strings_or(const std::string& key, const std::vector<std::string>& fallback);
  std::vector<std::string> require_strings(const std::string& key);
  /// A mapping of any keys to scalar values.
  std::map<std::string, std::string> string_map(const std::string& key);
  /// The names in this mapping, in file order.
  std::vector<std::string> names() const;
  /// Whether the key holds a mapping.
  bool is_mapping(const std::string& key) const;
  /// A mapping of mappings, in file order (spouts, bolts, brokers). Missing: empty.
  std::vector<std::pair<std::string, Section>> sections(const std::string& key);
  /// A sequence of mappings (inputs). Missing: empty. A single mapping counts as a sequence of one.
  std::vector<Section> section_list(const std::string& key);
  std::optional<Section> optional_section(const std::string& key);
  Section require_section(const std::string& key);

  /// \throws ConfigError for the first key that was never asked for. Also call it on every section read.
  void finish() const;

  /// An error at this key's value (or at this section, when `key` is empty or missing), for checks of the caller.
  [[nodiscard]] ConfigError error(const std::string& key, const std::string& problem,
                                  const std::string& remedy = "") const;
  /// An error at one character of this key's value, which is a single value: `offset` bytes from its beginning.
  [[nodiscard]] ConfigError error_within(const std::string& key, std::size_t offset, const std::string& problem) const;
  Location where(const std::string& key = "") const;
  const std::string& path() const;  ///< dotted path of this section; empty at the top

 private:
  struct Impl;
  explicit Section(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}
  std::shared_ptr<Impl> impl_;
};

/// "250ms", "2s", "5m", "1h", "10us"; nullopt for anything else.
std::optional<std::chrono::microseconds> parse_duration(const std::string& text);

/// The candidate nearest to `word` by edit distance, when it is near enough to suggest; otherwise empty.
std::string nearest(std::string_view word, const std::vector<std::string>& candidates);

}  // namespace iotcloud::config
