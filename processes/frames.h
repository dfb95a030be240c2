#pragma once

#include <cstddef>
#include <optional>
#include <string>

/// Frames on a stream of bytes: a length of four bytes, most significant first, and a body of that length.
namespace iotcloud::processes {

inline constexpr std::size_t max_frame = 16u << 20;

/// Makes a frame of a body.
std::string frame(const std::string& body);

/// Whether a FrameReader takes this frame; otherwise it ends its connection.
bool fits(const std::string& frame);

/// Cuts a stream of bytes into frames. Not thread safe.
class FrameReader {
 public:
  void feed(const char* bytes, std::size_t size) { buffer_.append(bytes, size); }
  /// The next frame's body; nullopt until it is complete. \throws config::Error for a frame longer than `max_frame`.
  std::optional<std::string> next();

 private:
  std::string buffer_;
};

}  // namespace iotcloud::processes
