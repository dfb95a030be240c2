#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/property_reader.h>

/// Frames in a stream of bytes, and connections that carry them: for drivers of devices on lines, sockets and pipes.
namespace iotcloud::drivers::stream {

/// How a stream says where a frame ends.
enum class Framing {
  delimiter,  ///< by bytes that no frame has, such as the end of a line
  length,     ///< by its length, which comes first
  cobs,       ///< consistent overhead byte stuffing: a zero byte ends it
  slip,       ///< RFC 1055
  none,       ///< not at all: what comes at once is a frame
};

struct FramingOptions {
  Framing kind = Framing::delimiter;
  std::string delimiter = "\n";
  std::size_t length_bytes = 2;       ///< 1, 2 or 4
  bool little_endian = false;         ///< of the length
  bool length_counts_itself = false;  ///< the length is that of head and frame
  std::size_t most_bytes = 65'536;    ///< a longer frame is refused
};

/// What cannot be a frame, or not be framed. what() says why.
struct FramingError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The properties that say how a device frames its bytes. \param kind the default of `framing`
constexpr auto framing_properties(std::string_view kind) {
  return std::array{
      PropertySpec{.name = "framing",
                   .default_value = kind,
                   .choices = {"delimiter", "length", "cobs", "slip", "none"},
                   .text = "where a frame ends"},
      PropertySpec{.name = "delimiter",
                   .default_value = "\\n",
                   .text = "framing delimiter: the bytes that end a frame, with \\n, \\r, \\t, \\0, \\\\ and \\x1f"},
      PropertySpec{.name = "length_bytes",
                   .default_value = "2",
                   .choices = {"1", "2", "4"},
                   .text = "framing length: size of the length"},
      PropertySpec{.name = "length_order",
                   .default_value = "big",
                   .choices = {"big", "little"},
                   .text = "framing length: which byte of the length comes first"},
      PropertySpec{.name = "length_of",
                   .default_value = "frame",
                   .choices = {"frame", "all"},
                   .text = "framing length: what it counts; all: the length, too"},
      PropertySpec{.name = "most_bytes",
                   .type = PropertyType::integer,
                   .unit = "bytes",
                   .min = 1,
                   .max = 16 << 20,
                   .default_value = "65536",
                   .text = "of a frame; a longer one is refused"},
  };
}

/// Two lists of properties as one.
template <std::size_t First, std::size_t Second>
constexpr std::array<PropertySpec, First + Second> joined(const std::array<PropertySpec, First>& first,
                                                          const std::array<PropertySpec, Second>& second) {
  std::array<PropertySpec, First + Second> all{};
  for (std::size_t i = 0; i < First; ++i) all[i] = first[i];
  for (std::size_t i = 0; i < Second; ++i) all[First + i] = second[i];
  return all;
}

/// \throws std::invalid_argument naming the property that is wrong.
FramingOptions read_framing(PropertyReader& reader);

/// The bytes that a text stands for: \n, \r, \t, \0, \\ and \x1f. \throws std::invalid_argument for other escapes.
std::string unescaped(const std::string& text);

/// The bytes of a frame on the wire. \throws FramingError when it is too long, or has the delimiter in it.
std::string framed(const FramingOptions& options, std::span<const std::byte> frame);

/// Cuts a stream into frames. It holds no more than one frame of the longest size and what it was fed last, whatever
/// comes. Not thread safe.
///
///     decoder.feed(bytes);
///     while (auto frame = decoder.next()) use(*frame);
class FrameDecoder {
 public:
  explicit FrameDecoder(FramingOptions options);

  /// Call it when next() has no more frames.
  void feed(std::span<const std::byte> bytes);
  /// The next whole frame; nullopt: it takes more bytes. Frames that are too long or malformed are left out and
  /// counted. Between COBS or SLIP frames empty ones mean nothing and are left out.
  /// \throws FramingError when the stream cannot be followed: a length that no frame may have. All bytes are forgotten.
  std::optional<Payload> next();
  /// Forgets the beginning of a frame.
  void reset();
  /// Whether there is one.
  bool unfinished() const { return skips_ || begin_ < buffer_.size(); }
  std::uint64_t refused() const { return refused_; }  ///< frames that were left out

 private:
  std::optional<Payload> next_delimited(std::string_view delimiter, std::size_t most);
  std::optional<Payload> next_counted();
  std::optional<Payload> decoded(std::span<const std::byte> encoded);
  std::string_view held() const;

  const FramingOptions options_;
  std::vector<std::byte> buffer_;
  std::size_t begin_ = 0;    ///< in buffer_: before it all has been handed out
  std::size_t scanned_ = 0;  ///< so many bytes from there have no delimiter
  bool skips_ = false;       ///< until the next delimiter: the frame is too long
  std::uint64_t refused_ = 0;
};

}  // namespace iotcloud::drivers::stream
