#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

/// Reads a deployment's properties strictly: ask for each by name, then finish(), so that a misspelt property is an
/// error and not a default. Messages name the property, its value and what would be right. Not thread safe; refers to
/// the map, which outlives it.
class PropertyReader {
 public:
  explicit PropertyReader(const PropertyMap& properties) : properties_(properties) {}

  std::string text(const std::string& name, const std::string& fallback);
  /// \throws std::invalid_argument when it is not a finite number, or not within [min, max].
  double number(const std::string& name, double fallback, double min, double max);
  std::int64_t integer(const std::string& name, std::int64_t fallback, std::int64_t min, std::int64_t max);
  /// "true" or "false".
  bool flag(const std::string& name, bool fallback);
  /// \throws std::invalid_argument that lists the choices when it is none of them.
  std::string choice(const std::string& name, const std::string& fallback, const std::vector<std::string>& choices);

  /// \throws std::invalid_argument for a property that was not asked for; the message lists those that were. Properties
  /// that begin with "channel." are the driver host's and pass; so are `thread`, `hang_limit` and `isolation`.
  void finish() const;

 private:
  const std::string* find(const std::string& name);
  const PropertyMap& properties_;
  std::set<std::string> known_;
};

}  // namespace iotcloud::drivers
