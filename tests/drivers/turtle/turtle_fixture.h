#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <unistd.h>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/turtle/command.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>
#include <iotcloud/tests/drivers/turtle/reference_follower.h>

/// Helpers for tests of a whole turtle driver.
namespace iotcloud::drivers::turtle {

inline const Descriptor turtle = describe<TurtleDriver>("turtle", "test", true);

inline Message command(const std::string& text, std::int64_t time_ms = 0) {
  Message message;
  message.payload = Payload::copy(text);
  message.time_ms = time_ms;
  return message;
}

inline Message command(const Velocity& velocity, std::int64_t time_ms = 0) {
  return command(as_json(velocity), time_ms);
}

inline std::vector<std::uint16_t> decoded(const Message& message) {
  std::vector<std::uint16_t> mm(depth::frame_pixels);
  depth::DepthDecoder decoder;
  EXPECT_EQ(decoder.decode(message.payload.bytes(), depth::FrameSpan(mm)), depth::DecodeError::none);
  return mm;
}

/// A file of this process, removed at the end.
class ScratchFile {
 public:
  explicit ScratchFile(const std::string& name)
      : path_(std::filesystem::temp_directory_path() / ("turtle-" + std::to_string(getpid()) + "-" + name)) {}
  ~ScratchFile() { std::filesystem::remove(path_); }
  std::string path() const { return path_.string(); }
  /// The rows, each by column names, which are in the first line.
  std::vector<std::map<std::string, std::string>> rows() const {
    std::ifstream file(path_);
    std::vector<std::string> names;
    std::vector<std::map<std::string, std::string>> rows;
    for (std::string line; std::getline(file, line);) {
      std::vector<std::string> fields(1);
      for (const char c : line) {
        if (c == ',') {
          fields.emplace_back();
        } else {
          fields.back() += c;
        }
      }
      if (names.empty()) {
        names = fields;
        continue;
      }
      EXPECT_EQ(fields.size(), names.size()) << line;
      auto& row = rows.emplace_back();
      for (std::size_t i = 0; i < std::min(fields.size(), names.size()); ++i) row[names[i]] = fields[i];
    }
    return rows;
  }

 private:
  std::filesystem::path path_;
};

inline double number(const std::map<std::string, std::string>& row, const std::string& column) {
  return std::strtod(row.at(column).c_str(), nullptr);
}

}  // namespace iotcloud::drivers::turtle
