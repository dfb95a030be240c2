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

/// One mapping of a YAML file, read strictly: finish() reports a key that no reader has asked for as unknown, with the
/// nearest known key. Wrong types, missing keys and values out of range throw ConfigError with file, line, column, the
/// dotted key and what would be right. Duplicate keys are errors. Not thread safe; cheap to copy (copies share the
/// document).
///
/// While a reader runs in read_file(), read_text() or all_errors(), an error is noted instead of thrown, and the key's
/// fallback is returned (without one: an empty or the least value, a section without keys), so that reading goes on; at
/// the end all errors are thrown together, a line for each.
class YamlSection {
 public:
  /// \throws ConfigError if the file cannot be read, is not YAML, or has no mapping at the top; and if it is not UTF-8,
  /// has control characters, or has more than 4 MiB, 32 levels or 500'000 values.
  static YamlSection load_file(const std::string& path);
  /// \param name stands for the file in messages.
  static YamlSection parse(std::string_view text, const std::string& name);

  /// Lets `read` read a whole file, and throws all errors of the file together. \throws ConfigError as load_file()
  /// does, too.
  static void read_file(const std::string& path, const std::function<void(YamlSection&)>& read);
  static void read_text(std::string_view text, const std::string& name, const std::function<void(YamlSection&)>& read);
  /// Runs `read`, and throws all errors that this document's sections met in it together. Inside of another call of it
  /// for this document the outermost one throws.
  void all_errors(const std::function<void()>& read) const;
  /// Whether all_errors() runs and has met an error: what was read may be a stand-in.
  bool has_errors() const;
  /// Whether all_errors() runs and this key's value is a stand-in.
  bool is_wrong(const std::string& key) const;
  /// Runs a part of all_errors() that throws its errors. When it does, the error is noted, the part ends, and finish()
  /// of this section no longer knows all keys, and reports none. Outside of all_errors() the error goes on.
  void part(const std::function<void()>& read) const;
  /// Notes (in all_errors()) or throws error(key, problem, remedy), for the caller's own checks. What was read of a key
  /// that has an error already gets no other one.
  void refuse(const std::string& key, const std::string& problem, const std::string& remedy = "") const;
  /// Notes (in all_errors()) or throws an error of error_within() or error().
  void refuse(const ConfigError& error) const;
  /// Runs a check of the caller's, and refuses `key` with the Error that it throws; a ConfigError has its own key.
  template <typename Check>
  void check(const std::string& key, Check&& check) const {
    try {
      check();
    } catch (const ConfigError& error) {
      refuse(error);
    } catch (const Error& error) {
      refuse(key, error.what());
    }
  }

  /// Says that a process on another machine will run with this document: files and environment variables that it names
  /// need not be here.
  void is_for_another_machine() const;
  /// Whether files and environment variables that the document names are to be looked at now.
  bool runs_here() const;

  bool has(const std::string& key) const;

  std::string require_string(const std::string& key);
  std::string string_or(const std::string& key, const std::string& fallback);
  std::optional<std::string> optional_string(const std::string& key);
  std::int64_t int_or(const std::string& key, std::int64_t fallback, std::int64_t min, std::int64_t max);
  std::int64_t require_int(const std::string& key, std::int64_t min, std::int64_t max);
  double double_or(const std::string& key, double fallback, double min, double max);
  bool bool_or(const std::string& key, bool fallback);
  /// "250ms", "2s", "5m", "1h", "10us". A number without a unit is an error, because its unit would be a guess.
  std::chrono::microseconds duration_or(const std::string& key, std::chrono::microseconds fallback);
  /// One of `choices`; the error message lists them.
  std::string choice_or(const std::string& key, const std::string& fallback, const std::vector<std::string>& choices);
  std::string require_choice(const std::string& key, const std::vector<std::string>& choices);

  /// A sequence of strings; a single string counts as a sequence of one.
  std::vector<std::string> strings_or(const std::string& key, const std::vector<std::string>& fallback);
  std::vector<std::string> require_strings(const std::string& key);
  struct Item;
  /// A sequence of texts and mappings, not empty; a single text counts as a sequence of one.
  std::vector<Item> require_items(const std::string& key);
  /// A mapping of any keys to scalar values.
  std::map<std::string, std::string> string_map(const std::string& key);
  /// The names in this mapping, in file order.
  std::vector<std::string> names() const;
  /// Whether the key holds a sequence.
  bool is_list(const std::string& key) const;
  /// Whether the key holds a mapping.
  bool is_mapping(const std::string& key) const;
  /// A mapping of mappings, in file order (spouts, bolts, brokers). Missing: empty.
  std::vector<std::pair<std::string, YamlSection>> sections(const std::string& key);
  /// A sequence of mappings (inputs). Missing: empty. A single mapping counts as a sequence of one.
  std::vector<YamlSection> section_list(const std::string& key);
  std::optional<YamlSection> optional_section(const std::string& key);
  YamlSection require_section(const std::string& key);

  /// \throws ConfigError that names every key that nobody asked for, a line for each. Call it on every section that was
  /// read.
  void finish() const;

  /// An error at this key's value (at this section if `key` is empty or missing), for the caller's own checks.
  [[nodiscard]] ConfigError error(const std::string& key, const std::string& problem,
                                  const std::string& remedy = "") const;
  /// An error at one character of this key's value, a scalar: `offset` bytes from its beginning.
  [[nodiscard]] ConfigError error_within(const std::string& key, std::size_t offset, const std::string& problem) const;
  Location where(const std::string& key = "") const;
  const std::string& path() const;  ///< dotted path of this section; empty at the top

 private:
  struct Impl;
  /// As parse(), but duplicate keys are noted in the document for all_errors().
  static YamlSection parse_keeping(std::string_view text, const std::string& name);
  explicit YamlSection(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}
  std::shared_ptr<Impl> impl_;
};

/// One item of a sequence: a text, or a mapping.
struct YamlSection::Item {
  std::string text;                    ///< empty if it is a mapping
  std::optional<YamlSection> mapping;  ///< its finish() is the caller's to call
};

/// "250ms", "2s", "5m", "1h", "10us"; nullopt for anything else.
std::optional<std::chrono::microseconds> parse_duration(const std::string& text);

/// The candidate nearest to `word` by edit distance, if it is near enough to suggest; otherwise empty.
std::string nearest(std::string_view word, const std::vector<std::string>& candidates);

}  // namespace iotcloud::config
