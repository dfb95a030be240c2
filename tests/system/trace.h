#pragma once

#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

namespace iotcloud::tests {

using Row = std::map<std::string, std::string>;

inline std::vector<std::string> split_row(const std::string& line) {
  std::vector<std::string> words;
  std::istringstream stream(line);
  for (std::string word; std::getline(stream, word, ',');) words.push_back(word);
  return words;
}

/// The complete rows of a trace (drivers/turtle/README.md), by column name.
inline std::vector<Row> read_trace(const std::filesystem::path& path) {
  std::vector<Row> rows;
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) return rows;
  const auto names = split_row(line);
  while (std::getline(file, line)) {
    const auto words = split_row(line);
    Row row;
    for (std::size_t i = 0; i < words.size() && i < names.size(); ++i) row[names[i]] = words[i];
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace iotcloud::tests
