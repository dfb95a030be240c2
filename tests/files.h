#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace iotcloud::tests {

/// \return the path.
inline std::string write_file(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
  return path;
}

/// \return the contents; empty also if the file cannot be read.
inline std::string read_file(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace iotcloud::tests
