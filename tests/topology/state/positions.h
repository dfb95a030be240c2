#pragma once

#include <cstdint>
#include <set>
#include <sstream>
#include <string>

namespace iotcloud::topology::workshop {

/// The positions of a driver's messages that were counted: all below `next`, and some beyond. A message that failed
/// comes again after messages that were sent later.
struct Positions {
  std::int64_t next = 0;
  std::set<std::int64_t> beyond;

  /// \param text as text() gives it, or empty.
  static Positions of(const std::string& text) {
    Positions positions;
    std::istringstream words(text);
    words >> positions.next;
    for (std::int64_t each = 0; words >> each;) positions.beyond.insert(each);
    return positions;
  }
  std::string text() const {
    std::string words = std::to_string(next);
    for (const auto each : beyond) words += " " + std::to_string(each);
    return words;
  }
  /// \return false: it was counted before.
  bool count(std::int64_t position) {
    if (position < next || !beyond.insert(position).second) return false;
    for (; beyond.erase(next) > 0; ++next) continue;
    return true;
  }
};

}  // namespace iotcloud::topology::workshop
