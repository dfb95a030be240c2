#include <algorithm>
#include <charconv>
#include <cstring>
#include <utility>

#include <iotcloud/drivers/stream/framing.h>

namespace iotcloud::drivers::stream {

namespace {

constexpr char slip_end = '\xc0', slip_escape = '\xdb', slip_escaped_end = '\xdc', slip_escaped_escape = '\xdd';
constexpr std::size_t cobs_block = 254;

std::string_view text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// nullopt: it is no COBS.
std::optional<std::string> from_cobs(std::string_view encoded) {
  std::string frame;
  frame.reserve(encoded.size());
  while (!encoded.empty()) {
    const std::size_t code = static_cast<unsigned char>(encoded.front());
    if (code == 0 || code > encoded.size()) return std::nullopt;
    frame += encoded.substr(1, code - 1);
    encoded.remove_prefix(code);
    if (code <= cobs_block && !encoded.empty()) frame += '\0';
  }
  return frame;
}

std::string to_cobs(std::string_view frame) {
  std::string encoded;
  encoded.reserve(frame.size() + frame.size() / cobs_block + 2);
  for (;;) {
    const std::size_t zero = std::min(frame.find('\0'), frame.size());
    const std::size_t block = std::min(zero, cobs_block);
    encoded += static_cast<char>(block + 1);
    encoded += frame.substr(0, block);
    frame.remove_prefix(block);
    if (block == cobs_block) {
      if (frame.empty()) break;  // a full block stands for no zero
      continue;
    }
    if (frame.empty()) break;
    frame.remove_prefix(1);  // the zero that the code stands for
  }
  encoded += '\0';
  return encoded;
}

/// nullopt: it is no SLIP.
std::optional<std::string> from_slip(std::string_view encoded) {
  std::string frame;
  frame.reserve(encoded.size());
  for (std::size_t i = 0; i < encoded.size(); ++i) {
    if (encoded[i] != slip_escape) {
      frame += encoded[i];
      continue;
    }
    if (++i == encoded.size()) return std::nullopt;
    if (encoded[i] != slip_escaped_end && encoded[i] != slip_escaped_escape) return std::nullopt;
    frame += encoded[i] == slip_escaped_end ? slip_end : slip_escape;
  }
  return frame;
}

std::string to_slip(std::string_view frame) {
  std::string encoded(1, slip_end);  // ends what noise has begun
  for (const char c : frame) {
    if (c == slip_end || c == slip_escape) {
      encoded += slip_escape;
      encoded += c == slip_end ? slip_escaped_end : slip_escaped_escape;
    } else {
      encoded += c;
    }
  }
  encoded += slip_end;
  return encoded;
}

std::string length_head(const FramingOptions& options, std::size_t frame) {
  const std::size_t length = frame + (options.length_counts_itself ? options.length_bytes : 0);
  if (options.length_bytes < sizeof length && length >> (8 * options.length_bytes) != 0) {
    throw FramingError("a frame of " + std::to_string(frame) + " bytes has a length that takes more than the " +
                       std::to_string(options.length_bytes) + " of length_bytes");
  }
  std::string head(options.length_bytes, '\0');
  for (std::size_t i = 0; i < options.length_bytes; ++i) {
    const std::size_t place = options.little_endian ? i : options.length_bytes - 1 - i;
    head[place] = static_cast<char>(length >> (8 * i) & 0xff);
  }
  return head;
}

std::size_t length_in(const FramingOptions& options, std::string_view head) {
  std::size_t length = 0;
  for (std::size_t i = 0; i < options.length_bytes; ++i) {
    const std::size_t place = options.little_endian ? options.length_bytes - 1 - i : i;
    length = length << 8 | static_cast<unsigned char>(head[place]);
  }
  return length;
}

[[noreturn]] void refuse_length(std::size_t length, std::size_t most) {
  throw FramingError("a frame with the length " + std::to_string(length) + " (most_bytes is " + std::to_string(most) +
                     "): the bytes are no such frames, or one was lost");
}

}  // namespace

FramingOptions read_framing(PropertyReader& reader) {
  FramingOptions options;
  const std::string kind = reader.choice("framing", "delimiter", {"delimiter", "length", "cobs", "slip", "none"});
  options.kind = kind == "length" ? Framing::length
                 : kind == "cobs" ? Framing::cobs
                 : kind == "slip" ? Framing::slip
                 : kind == "none" ? Framing::none
                                  : Framing::delimiter;
  const std::string delimiter = reader.text("delimiter", "\\n");
  try {
    options.delimiter = unescaped(delimiter);
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument("property \"delimiter\" is \"" + delimiter + "\": " + e.what());
  }
  constexpr std::size_t longest_delimiter = 16;
  if (options.delimiter.empty() || options.delimiter.size() > longest_delimiter) {
    throw std::invalid_argument("property \"delimiter\" is \"" + delimiter + "\"; it takes 1 to 16 bytes");
  }
  options.length_bytes = std::stoul(reader.choice("length_bytes", "2", {"1", "2", "4"}));
  options.little_endian = reader.choice("length_order", "big", {"big", "little"}) == "little";
  options.length_counts_itself = reader.choice("length_of", "frame", {"frame", "all"}) == "all";
  options.most_bytes = static_cast<std::size_t>(reader.integer("most_bytes", 65'536, 1, 16 << 20));
  return options;
}

std::string unescaped(const std::string& text) {
  std::string bytes;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '\\') {
      bytes += text[i];
      continue;
    }
    const char kind = ++i < text.size() ? text[i] : ' ';
    constexpr std::string_view names = "nrt0\\", values("\n\r\t\0\\", 5);
    if (const auto known = names.find(kind); known != std::string_view::npos) {
      bytes += values[known];
      continue;
    }
    unsigned value = 0;
    const char* digits = text.data() + i + 1;
    const bool hex = kind == 'x' && text.size() - i > 2;
    if (!hex || std::from_chars(digits, digits + 2, value, 16).ptr != digits + 2) {
      throw std::invalid_argument("a \\ begins \\n, \\r, \\t, \\0, \\\\ or two hexadecimal digits such as \\x1f");
    }
    bytes += static_cast<char>(value);
    i += 2;
  }
  return bytes;
}

std::string framed(const FramingOptions& options, std::span<const std::byte> frame) {
  const std::string_view text = text_of(frame);
  if (text.size() > options.most_bytes) {
    throw FramingError("a frame of " + std::to_string(text.size()) + " bytes is longer than most_bytes, " +
                       std::to_string(options.most_bytes));
  }
  switch (options.kind) {
    case Framing::length:
      return length_head(options, text.size()).append(text);
    case Framing::cobs:
      return to_cobs(text);
    case Framing::slip:
      return to_slip(text);
    case Framing::none:
      return std::string(text);
    case Framing::delimiter:
      break;
  }
  std::string bytes = std::string(text) + options.delimiter;
  if (bytes.find(options.delimiter) != text.size())
    throw FramingError("a frame has the delimiter in it, so the device would take it for two");
  return bytes;
}

FrameDecoder::FrameDecoder(FramingOptions options) : options_(std::move(options)) {}

std::string_view FrameDecoder::held() const {
  return text_of(std::span(buffer_).subspan(begin_));
}

void FrameDecoder::feed(std::span<const std::byte> bytes) {
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(std::exchange(begin_, 0)));
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
}

void FrameDecoder::reset() {
  buffer_.clear();
  begin_ = scanned_ = 0;
  skips_ = false;
}

std::optional<Payload> FrameDecoder::next() {
  switch (options_.kind) {
    case Framing::length:
      return next_counted();
    case Framing::cobs:
      return next_delimited(std::string_view("\0", 1), options_.most_bytes + options_.most_bytes / cobs_block + 1);
    case Framing::slip:
      return next_delimited(std::string_view(&slip_end, 1), 2 * options_.most_bytes);
    case Framing::delimiter:
      return next_delimited(options_.delimiter, options_.most_bytes);
    case Framing::none:
      break;
  }
  const std::string_view text = held().substr(0, options_.most_bytes);
  begin_ += text.size();
  if (text.empty()) return std::nullopt;
  return Payload::copy(text);
}

std::optional<Payload> FrameDecoder::next_delimited(std::string_view delimiter, std::size_t most) {
  for (;;) {
    const std::string_view text = held();
    const std::size_t end = text.find(delimiter, scanned_);
    if (end == std::string_view::npos) {
      // The last bytes may be the beginning of a delimiter.
      scanned_ = text.size() - std::min(text.size(), delimiter.size() - 1);
      if (skips_ || scanned_ > most) {
        skips_ = true;
        begin_ += std::exchange(scanned_, 0);
      }
      return std::nullopt;
    }
    const auto encoded = std::span(buffer_).subspan(begin_, end);
    begin_ += end + delimiter.size();
    scanned_ = 0;
    if (std::exchange(skips_, false) || encoded.size() > most) {
      ++refused_;
      continue;
    }
    if (options_.kind == Framing::delimiter) return Payload::copy(encoded);
    if (encoded.empty()) continue;
    if (auto frame = decoded(encoded)) return frame;
    ++refused_;
  }
}

std::optional<Payload> FrameDecoder::decoded(std::span<const std::byte> encoded) {
  auto frame = options_.kind == Framing::cobs ? from_cobs(text_of(encoded)) : from_slip(text_of(encoded));
  if (!frame || frame->size() > options_.most_bytes) return std::nullopt;
  return Payload::take(std::move(*frame));
}

std::optional<Payload> FrameDecoder::next_counted() {
  const std::string_view text = held();
  if (text.size() < options_.length_bytes) return std::nullopt;
  const std::size_t length = length_in(options_, text);
  const std::size_t head = options_.length_counts_itself ? options_.length_bytes : 0;
  if (length < head || length - head > options_.most_bytes) {
    reset();
    ++refused_;
    refuse_length(length, options_.most_bytes);
  }
  const std::size_t size = length - head;
  if (text.size() - options_.length_bytes < size) return std::nullopt;
  const auto frame = std::span(buffer_).subspan(begin_ + options_.length_bytes, size);
  begin_ += options_.length_bytes + size;
  return Payload::copy(frame);
}

}  // namespace iotcloud::drivers::stream
