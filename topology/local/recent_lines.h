#pragma once

#include <cstddef>
#include <string>

namespace iotcloud::local {

/// Keeps the newest lines that this process logs, for its console, from the first of these objects on until the last
/// has gone; they go to stderr as well. Thread safe.
class RecentLines {
 public:
  static constexpr std::size_t most_bytes = std::size_t{1} << 20U;

  RecentLines();
  ~RecentLines();
  RecentLines(const RecentLines&) = delete;
  RecentLines& operator=(const RecentLines&) = delete;

  /// What was logged between two positions.
  struct Part {
    std::string text;      ///< whole lines
    std::string position;  ///< where the next part begins
  };
  /// \param position of the last part; empty: the newest lines are wanted \throws config::Error if it is no position
  static Part read(const std::string& position, std::size_t most);
};

}  // namespace iotcloud::local
