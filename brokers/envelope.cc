#include "iotcloud/brokers/envelope.h"

#include <array>
#include <charconv>
#include <cstring>
#include <string_view>
#include <utility>

#include <iotcloud/brokers/limits.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers {
namespace {

// Thrift's binary protocol: a field is its type (1 byte), its id (2) and its value; a string its length (4) and bytes;
// a map its types (1 each), its size (4) and entries; a struct ends with a type of 0. Numbers are big endian.
enum class Type : std::uint8_t {
  stop = 0,
  boolean = 2,
  byte = 3,
  real = 4,
  i16 = 6,
  i32 = 8,
  i64 = 10,
  string = 11,
  structure = 12,
  map = 13,
  set = 14,
  list = 15,
};
enum Field : std::uint16_t { sensor_id = 1, site = 2, body = 3, properties = 4 };

constexpr std::string_view time_property = "time";
constexpr std::size_t field_head = 3;
constexpr std::size_t length_size = 4;
constexpr int deepest = 32;  // nested structs and containers in skipped fields

class EnvelopeWriter {
 public:
  explicit EnvelopeWriter(std::byte* at) : at_(at) {}
  void field(Type type, Field id) {
    number(static_cast<std::uint8_t>(type));
    number(static_cast<std::uint16_t>(id));
  }
  template <typename Number>
  void number(Number value) {
    for (int shift = (static_cast<int>(sizeof(Number)) - 1) * 8; shift >= 0; shift -= 8) {
      *at_++ = static_cast<std::byte>(value >> shift & 0xff);
    }
  }
  void string(const void* data, std::size_t size) {
    number(static_cast<std::uint32_t>(size));
    if (size > 0) std::memcpy(at_, data, size);
    at_ += size;
  }
  void string(std::string_view text) { string(text.data(), text.size()); }

 private:
  std::byte* at_;
};

/// Takes bytes from the front; after the first error every call fails.
class EnvelopeReader {
 public:
  explicit EnvelopeReader(std::span<const std::byte> bytes) : rest_(bytes) {}
  bool good() const { return good_; }
  std::size_t left() const { return rest_.size(); }

  std::span<const std::byte> take(std::size_t size) {
    if (size > rest_.size()) {
      fail();
      return {};
    }
    const auto taken = rest_.first(size);
    rest_ = rest_.subspan(size);
    return taken;
  }
  template <typename Number>
  Number number() {
    std::uint64_t value = 0;
    for (const std::byte part : take(sizeof(Number))) value = value << 8U | std::to_integer<std::uint64_t>(part);
    return static_cast<Number>(value);
  }
  Type type() { return static_cast<Type>(number<std::uint8_t>()); }
  std::span<const std::byte> string() {
    const auto size = number<std::int32_t>();
    if (size < 0) fail();
    return good_ ? take(static_cast<std::size_t>(size)) : std::span<const std::byte>();
  }
  std::string_view text() {
    const auto bytes = string();
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
  /// Reads the size of a container whose entries have at least `smallest` bytes each; a size beyond the remaining bytes
  /// is an error.
  std::size_t count(std::size_t smallest) {
    const auto size = number<std::int32_t>();
    if (size < 0 || static_cast<std::size_t>(size) > rest_.size() / smallest) fail();
    return good_ ? static_cast<std::size_t>(size) : 0;
  }
  void skip(Type type, int depth = 0);
  void fail() {
    good_ = false;
    rest_ = {};
  }

 private:
  std::span<const std::byte> rest_;
  bool good_ = true;
};

void EnvelopeReader::skip(Type type, int depth) {
  if (depth > deepest) {
    fail();
    return;
  }
  switch (type) {
    case Type::boolean:
    case Type::byte:
      take(1);
      return;
    case Type::i16:
      take(2);
      return;
    case Type::i32:
      take(4);
      return;
    case Type::real:
    case Type::i64:
      take(8);
      return;
    case Type::string:
      string();
      return;
    case Type::structure:
      for (Type field = this->type(); good_ && field != Type::stop; field = this->type()) {
        take(2);
        skip(field, depth + 1);
      }
      return;
    case Type::map: {
      const Type key = this->type();
      const Type value = this->type();
      const std::size_t entries = count(1);
      for (std::size_t i = 0; i < entries && good_; ++i) {
        skip(key, depth + 1);
        skip(value, depth + 1);
      }
      return;
    }
    case Type::set:
    case Type::list: {
      const Type element = this->type();
      const std::size_t entries = count(1);
      for (std::size_t i = 0; i < entries && good_; ++i) skip(element, depth + 1);
      return;
    }
    default:
      fail();
  }
}

void read_properties(EnvelopeReader& reader, OpenedEnvelope& opened) {
  const Type key_type = reader.type();
  const Type value_type = reader.type();
  const std::size_t entries = reader.count(2 * length_size);
  const bool strings = key_type == Type::string && value_type == Type::string;
  if (entries > max_received_properties || (entries > 0 && !strings)) reader.fail();
  for (std::size_t i = 0; i < entries && reader.good(); ++i) {
    const std::string_view key = reader.text();
    const std::string_view value = reader.text();
    if (!reader.good()) return;
    if (key == time_property) {
      opened.time_ms = config::parse_number<std::int64_t>(value);
    } else {
      opened.message.properties.set(key, value);
    }
  }
}

}  // namespace

EnvelopeBytes encode_envelope(const Message& message) {
  std::array<char, 24> digits{};
  const char* const end = std::to_chars(digits.data(), digits.data() + digits.size(), message.time_ms).ptr;
  const std::string_view time(digits.data(), static_cast<std::size_t>(end - digits.data()));
  std::size_t entries = 1;
  std::size_t size = 3 * (field_head + length_size) + message.driver_id.size() + message.gateway_id.size() +
                     message.payload.size() + field_head + 2 + length_size + 2 * length_size + time_property.size() +
                     time.size() + 1;
  for (const auto& [name, value] : message.properties) {
    if (name == time_property) continue;
    ++entries;
    size += 2 * length_size + name.size() + value.size();
  }
  EnvelopeBytes encoded{std::unique_ptr<std::byte[]>(new std::byte[size]), size};
  EnvelopeWriter writer(encoded.data.get());
  writer.field(Type::string, sensor_id);
  writer.string(message.driver_id);
  writer.field(Type::string, site);
  writer.string(message.gateway_id);
  writer.field(Type::string, body);
  writer.string(message.payload.data(), message.payload.size());
  writer.field(Type::map, properties);
  writer.number(static_cast<std::uint8_t>(Type::string));
  writer.number(static_cast<std::uint8_t>(Type::string));
  writer.number(static_cast<std::uint32_t>(entries));
  writer.string(time_property);
  writer.string(time);
  for (const auto& [name, value] : message.properties) {
    if (name == time_property) continue;
    writer.string(name);
    writer.string(value);
  }
  writer.number(static_cast<std::uint8_t>(Type::stop));
  return encoded;
}

std::optional<OpenedEnvelope> open_envelope(std::span<const std::byte> bytes) {
  EnvelopeReader reader(bytes);
  OpenedEnvelope opened;
  for (Type type = reader.type(); reader.good() && type != Type::stop; type = reader.type()) {
    const auto id = reader.number<std::uint16_t>();
    if (type == Type::string && id == sensor_id) {
      opened.message.driver_id = reader.text();
    } else if (type == Type::string && id == site) {
      opened.message.gateway_id = reader.text();
    } else if (type == Type::string && id == body) {
      opened.body = reader.string();
    } else if (type == Type::map && id == properties) {
      read_properties(reader, opened);
    } else {
      reader.skip(type);
    }
  }
  if (!reader.good()) return std::nullopt;
  return opened;
}

}  // namespace iotcloud::brokers
