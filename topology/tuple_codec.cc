#include <cstring>
#include <limits>
#include <memory>
#include <string_view>

#include <iotcloud/topology/tuple_codec.h>

namespace iotcloud::topology {

namespace {

constexpr std::byte magic{0xC7};
constexpr std::byte version{1};

enum class Kind : std::uint8_t { null, no, yes, integer, real, string, payload };

constexpr std::uint64_t zigzag(std::int64_t number) {
  return (static_cast<std::uint64_t>(number) << 1) ^ static_cast<std::uint64_t>(number >> 63);
}
constexpr std::int64_t unzigzag(std::uint64_t code) {
  return static_cast<std::int64_t>((code >> 1) ^ (~(code & 1) + 1));
}

constexpr std::size_t count_size(std::uint64_t count) {
  std::size_t size = 1;
  while (count >>= 7) ++size;
  return size;
}

std::size_t bytes_size(std::size_t size) {
  return count_size(size) + size;
}

std::size_t value_size(const Value& value) {
  if (const auto* number = std::get_if<std::int64_t>(&value)) return 1 + count_size(zigzag(*number));
  if (std::holds_alternative<double>(value)) return 1 + 8;
  if (const auto* text = std::get_if<std::string>(&value)) return 1 + bytes_size(text->size());
  if (const auto* payload = std::get_if<Payload>(&value)) return 1 + bytes_size(payload->size());
  return 1;
}

/// Writes a tuple's parts. The caller has reserved enough memory.
class TupleWriter {
 public:
  explicit TupleWriter(std::byte* at) : at_(at) {}
  void byte(std::byte value) { *at_++ = value; }
  void count(std::uint64_t value) {
    for (; value >= 0x80; value >>= 7) byte(static_cast<std::byte>(value | 0x80));
    byte(static_cast<std::byte>(value));
  }
  void word(std::uint64_t value) {
    for (int i = 0; i < 8; ++i) byte(static_cast<std::byte>(value >> (8 * i)));
  }
  void bytes(const void* data, std::size_t size) {
    count(size);
    if (size > 0) std::memcpy(at_, data, size);
    at_ += size;
  }
  void value(const Value& value) {
    if (const auto* flag = std::get_if<bool>(&value)) {
      kind(*flag ? Kind::yes : Kind::no);
    } else if (const auto* number = std::get_if<std::int64_t>(&value)) {
      kind(Kind::integer);
      count(zigzag(*number));
    } else if (const auto* real = std::get_if<double>(&value)) {
      kind(Kind::real);
      std::uint64_t bits = 0;
      std::memcpy(&bits, real, sizeof bits);
      word(bits);
    } else if (const auto* text = std::get_if<std::string>(&value)) {
      kind(Kind::string);
      bytes(text->data(), text->size());
    } else if (const auto* payload = std::get_if<Payload>(&value)) {
      kind(Kind::payload);
      bytes(payload->data(), payload->size());
    } else {
      kind(Kind::null);
    }
  }

 private:
  void kind(Kind kind) { byte(static_cast<std::byte>(kind)); }
  std::byte* at_;
};

void encode(std::string_view component, std::string_view stream, int source_task, std::span<const std::uint64_t> ids,
            std::span<const Value> values, std::vector<std::byte>& out) {
  std::size_t size = 2 + bytes_size(component.size()) + bytes_size(stream.size()) + count_size(zigzag(source_task)) +
                     count_size(ids.size()) + 8 * ids.size() + count_size(values.size());
  for (const Value& value : values) size += value_size(value);
  const std::size_t begin = out.size();
  out.resize(begin + size);
  TupleWriter writer(out.data() + begin);
  writer.byte(magic);
  writer.byte(version);
  writer.bytes(component.data(), component.size());
  writer.bytes(stream.data(), stream.size());
  writer.count(zigzag(source_task));
  writer.count(ids.size());
  for (const std::uint64_t id : ids) writer.word(id);
  writer.count(values.size());
  for (const Value& value : values) writer.value(value);
}

/// Reads a tuple's parts; throws instead of reading beyond its bytes.
class TupleReader {
 public:
  explicit TupleReader(std::span<const std::byte> bytes) : bytes_(bytes) {}
  std::size_t offset() const { return at_; }
  std::size_t left() const { return bytes_.size() - at_; }

  std::byte byte(const char* what) {
    need(1, what);
    return bytes_[at_++];
  }
  std::uint64_t count(const char* what) {
    const std::size_t begin = at_;
    std::uint64_t value = 0;
    for (unsigned shift = 0;; shift += 7) {
      const auto group = std::to_integer<std::uint64_t>(byte(what));
      if (shift == 63 && group > 1) throw TupleFormatError(begin, std::string(what) + " does not fit into 64 bits");
      value |= (group & 0x7F) << shift;
      if (group >= 0x80) continue;
      if (group == 0 && shift > 0) throw TupleFormatError(begin, std::string(what) + " has more bytes than it needs");
      return value;
    }
  }
  /// Reads a count of items of at least `size` bytes each, and checks that so many bytes are left, so that the caller
  /// may allocate memory for the items.
  std::size_t count_within(const char* what, std::size_t limit, std::size_t size) {
    const std::size_t begin = at_;
    const std::uint64_t value = count(what);
    if (value > limit) {
      throw TupleFormatError(
          begin, std::string(what) + " is " + std::to_string(value) + ", the limit " + std::to_string(limit));
    }
    // checked first, because the product could overflow
    if (value > left()) need(static_cast<std::size_t>(value), what);
    need(static_cast<std::size_t>(value) * size, what);
    return static_cast<std::size_t>(value);
  }
  std::uint64_t word(const char* what) {
    need(8, what);
    std::uint64_t value = 0;
    for (unsigned i = 0; i < 8; ++i) value |= std::to_integer<std::uint64_t>(bytes_[at_++]) << (8 * i);
    return value;
  }
  std::span<const std::byte> bytes(const char* what, std::size_t limit) {
    const std::size_t size = count_within(what, limit, 1);
    at_ += size;
    return bytes_.subspan(at_ - size, size);
  }
  std::string text(const char* what, std::size_t limit) {
    const auto part = bytes(what, limit);
    return {reinterpret_cast<const char*>(part.data()), part.size()};
  }

 private:
  void need(std::size_t size, const char* what) const {
    if (left() < size) {
      throw TupleFormatError(bytes_.size(), std::string("the bytes end within ") + what + ", " +
                                                std::to_string(size - left()) + " are missing");
    }
  }

  std::span<const std::byte> bytes_;
  std::size_t at_ = 0;
};

Value read_value(TupleReader& reader, const Payload& whole) {
  const std::size_t begin = reader.offset();
  const auto kind = reader.byte("a value's kind");
  switch (static_cast<Kind>(kind)) {
    case Kind::null:
      return {};
    case Kind::no:
      return false;
    case Kind::yes:
      return true;
    case Kind::integer:
      return unzigzag(reader.count("an integer"));
    case Kind::real: {
      const std::uint64_t bits = reader.word("a double");
      double value = 0;
      std::memcpy(&value, &bits, sizeof value);
      return value;
    }
    case Kind::string:
      return reader.text("the length of a string", whole.size());
    case Kind::payload: {
      const auto part = reader.bytes("the length of a payload", whole.size());
      return part.empty() ? Payload() : Payload::wrap(std::make_shared<const Payload>(whole), part);
    }
  }
  throw TupleFormatError(
      begin, "there is no value of kind " + std::to_string(std::to_integer<int>(kind)) + "; the kinds are 0 to 6");
}

}  // namespace

void encode_tuple(const TupleRecord& record, std::vector<std::byte>& out) {
  encode(record.component, record.stream, record.source_task, record.ids, record.values.all(), out);
}

void encode_tuple(const Tuple& tuple, std::span<const std::uint64_t> ids, std::vector<std::byte>& out) {
  encode(tuple.source_component(), tuple.source_stream(), tuple.source_task(), ids, tuple.data()->values.all(), out);
}

TupleRecord decode_tuple(const Payload& bytes, const TupleLimits& limits) {
  if (bytes.size() > limits.bytes) {
    throw TupleFormatError(limits.bytes, "they are " + std::to_string(bytes.size()) + " bytes, the limit is " +
                                             std::to_string(limits.bytes));
  }
  TupleReader reader(bytes.bytes());
  if (reader.byte("the magic byte") != magic) throw TupleFormatError(0, "a tuple begins with 0xC7");
  if (const auto found = reader.byte("the version"); found != version) {
    throw TupleFormatError(1, "the encoding has version " + std::to_string(std::to_integer<int>(found)) +
                                  ", only 1 is known; use the same release on both sides");
  }
  TupleRecord record;
  record.component = reader.text("the length of the component's id", limits.name);
  record.stream = reader.text("the length of the stream's name", limits.name);
  const std::size_t task_at = reader.offset();
  const std::int64_t task = unzigzag(reader.count("the source task"));
  if (task < std::numeric_limits<int>::min() || task > std::numeric_limits<int>::max()) {
    throw TupleFormatError(task_at, "there is no task " + std::to_string(task));
  }
  record.source_task = static_cast<int>(task);
  const std::size_t ids = reader.count_within("the number of ids", limits.ids, 8);
  record.ids.reserve(ids);
  for (std::size_t i = 0; i < ids; ++i) record.ids.push_back(reader.word("an id"));
  const std::size_t fields = reader.count_within("the number of values", limits.fields, 1);
  for (std::size_t i = 0; i < fields; ++i) record.values.add(read_value(reader, bytes));
  if (reader.left() > 0) {
    throw TupleFormatError(reader.offset(), std::to_string(reader.left()) + " bytes follow the last value");
  }
  return record;
}

}  // namespace iotcloud::topology
