#include <cstdint>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/frames.h>

namespace iotcloud::processes {

namespace {

constexpr std::size_t head = 4;  ///< bytes of a frame's length

}  // namespace

std::string frame(const std::string& body) {
  const auto size = static_cast<std::uint32_t>(body.size());
  std::string bytes;
  bytes.reserve(sizeof(size) + body.size());
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>((size >> shift) & 0xff);
  return bytes += body;
}

bool fits(const std::string& frame) {
  return frame.size() <= head + max_frame;
}

std::optional<std::string> FrameReader::next() {
  if (buffer_.size() < head) return std::nullopt;
  std::size_t size = 0;
  for (std::size_t i = 0; i < head; ++i) size = (size << 8) | static_cast<unsigned char>(buffer_[i]);
  if (size > max_frame) throw config::Error(fmt::format("a frame of {} bytes; the limit is {}", size, max_frame));
  if (buffer_.size() < head + size) return std::nullopt;
  std::string body = buffer_.substr(head, size);
  buffer_.erase(0, head + size);
  return body;
}

}  // namespace iotcloud::processes
