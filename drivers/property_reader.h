#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

/// Reads a deployment's properties strictly: ask for each by name, then call finish(), so that a misspelt property is
/// an error and not a default. Messages name the property, its value and what would be right. Not thread safe; the map
/// must outlive the reader.
class PropertyReader {
 public:
  explicit PropertyReader(const PropertyMap& properties) : properties_(properties) {}

  std::string text(const std::string& name, const std::string& fallback);
  /// \throws std::invalid_argument unless the value is a finite number within [min, max].
  double number(const std::string& name, double fallback, double min, double max);
  std::int64_t integer(const std::string& name, std::int64_t fallback, std::int64_t min, std::int64_t max);
  /// "true" or "false".
  bool flag(const std::string& name, bool fallback);
  /// \throws std::invalid_argument that lists the choices unless the value is one of them.
  std::string choice(const std::string& name, const std::string& fallback, const std::vector<std::string>& choices);

  /// \throws std::invalid_argument for a property that the driver did not ask for; the message lists the known ones.
  /// Properties that begin with "channel." belong to the driver host and pass, as do `thread`, `hang_limit`,
  /// `isolation`, `network`, `on_partition` and `lease`.
  void finish() const;

 private:
  const std::string* find(const std::string& name);
  const PropertyMap& properties_;
  std::set<std::string> known_;
};

/// The words of a list in a property, such as "a, b": without the blanks around them, and without empty ones.
std::vector<std::string> words_of(const std::string& list, char separator = ',');

}  // namespace iotcloud::drivers
