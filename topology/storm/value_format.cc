#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <string_view>

#include <iotcloud/config/utf8.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {

namespace {

static_assert(std::endian::native == std::endian::little, "Java's side writes little endian");

enum class Kind : std::uint8_t { null, no, yes, integer, real, string, payload, of_tuple, array };

constexpr std::size_t most_bytes = std::numeric_limits<std::int32_t>::max();
constexpr std::size_t count_size = sizeof(std::uint32_t);
constexpr std::int32_t is_parcel = -1;  ///< in place of a count

std::size_t size_of_bytes(std::size_t size) {
  if (size > most_bytes) throw ValueFormatError("a value of " + std::to_string(size) + " bytes; Java takes 2 GiB");
  return 1 + count_size + size;
}

std::size_t size_of(const Value& value) {
  if (const auto* text = std::get_if<std::string>(&value)) {
    if (!config::is_utf8(*text)) throw ValueFormatError("a string that is not UTF-8; bytes go into a Payload");
    return size_of_bytes(text->size());
  }
  if (const auto* payload = std::get_if<Payload>(&value)) return size_of_bytes(payload->size());
  const bool number = std::holds_alternative<std::int64_t>(value) || std::holds_alternative<double>(value);
  return number ? 1 + 8 : 1;
}

/// Writes the parts of values.
class Writer {
 public:
  explicit Writer(std::byte* at) : at_(at) {}
  template <typename Number>
  void number(Number number) {
    std::memcpy(at_, &number, sizeof number);
    at_ += sizeof number;
  }
  void kind(Kind kind) { number(kind); }
  void bytes(Kind of, const void* data, std::size_t size) {
    kind(of);
    number(static_cast<std::uint32_t>(size));
    if (size > 0) std::memcpy(at_, data, size);
    at_ += size;
  }
  std::byte* at() const { return at_; }

 private:
  std::byte* at_;
};

void write(Writer& writer, const Value& value) {
  if (const auto* flag = std::get_if<bool>(&value)) {
    writer.kind(*flag ? Kind::yes : Kind::no);
  } else if (const auto* integer = std::get_if<std::int64_t>(&value)) {
    writer.kind(Kind::integer);
    writer.number(*integer);
  } else if (const auto* real = std::get_if<double>(&value)) {
    writer.kind(Kind::real);
    writer.number(*real);
  } else if (const auto* text = std::get_if<std::string>(&value)) {
    writer.bytes(Kind::string, text->data(), text->size());
  } else if (const auto* payload = std::get_if<Payload>(&value)) {
    writer.bytes(Kind::payload, payload->data(), payload->size());
  } else {
    writer.kind(Kind::null);
  }
}

/// Reads the parts of values; throws instead of reading beyond the bytes.
class Reader {
 public:
  explicit Reader(std::span<const std::byte> left) : left_(left) {}
  template <typename Number>
  Number number() {
    Number number{};
    std::memcpy(&number, bytes(sizeof number).data(), sizeof number);
    return number;
  }
  std::span<const std::byte> bytes(std::size_t size) {
    if (size > left_.size()) throw ValueFormatError("the bytes end within a value");
    const auto taken = left_.first(size);
    left_ = left_.subspan(size);
    return taken;
  }
  std::span<const std::byte> counted() { return bytes(number<std::uint32_t>()); }
  std::size_t left() const { return left_.size(); }

 private:
  std::span<const std::byte> left_;
};

Value read(Reader& reader, JavaArrays* arrays) {
  const auto kind = reader.number<Kind>();
  switch (kind) {
    case Kind::null:
      return {};
    case Kind::no:
      return false;
    case Kind::yes:
      return true;
    case Kind::integer:
      return reader.number<std::int64_t>();
    case Kind::real:
      return reader.number<double>();
    case Kind::string: {
      const auto text = reader.counted();
      return Value(std::in_place_type<std::string>, reinterpret_cast<const char*>(text.data()), text.size());
    }
    case Kind::payload:
      return Payload::copy(reader.counted());
    case Kind::array:
      if (arrays != nullptr) return arrays->next();
      break;
    case Kind::of_tuple:
      break;  // only to Java
  }
  throw ValueFormatError("there is no value of kind " + std::to_string(static_cast<int>(kind)));
}

}  // namespace

std::size_t find_arrays(std::span<const Value> values, std::vector<std::optional<JavaValue>>& elsewhere) {
  std::size_t bytes = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto* payload = std::get_if<Payload>(&values[i]);
    if (payload == nullptr || payload->size() < least_array || (i < elsewhere.size() && elsewhere[i])) continue;
    elsewhere.resize(std::max(elsewhere.size(), i + 1));
    elsewhere[i] = JavaValue{};
    bytes += payload->size();
  }
  return bytes;
}

std::size_t encoded_size(std::span<const Value> values, JavaValues elsewhere) {
  std::size_t size = count_size;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::size_t whole = size_of(values[i]);
    if (i >= elsewhere.size() || !elsewhere[i]) {
      size += whole;
    } else {
      size += elsewhere[i]->slot == JavaValue::next_array ? 1 : 1 + sizeof(JavaValue);
    }
  }
  return size;
}

std::byte* encode_values(std::span<const Value> values, std::byte* at, JavaValues elsewhere) noexcept {
  Writer writer(at);
  writer.number(static_cast<std::uint32_t>(values.size()));
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (i >= elsewhere.size() || !elsewhere[i]) {
      write(writer, values[i]);
    } else if (elsewhere[i]->slot == JavaValue::next_array) {
      writer.kind(Kind::array);
    } else {
      writer.kind(Kind::of_tuple);
      writer.number(*elsewhere[i]);
    }
  }
  return writer.at();
}

std::size_t encoded_parcel_size(std::span<const Value> values, std::span<const std::size_t> told) {
  for (const Value& value : values) size_of(value);
  std::size_t size = count_size + sizeof(std::uint64_t) + count_size;
  for (const std::size_t place : told) size += size_of(values[place]);
  return size;
}

std::byte* encode_parcel(const void* parcel, std::size_t count, std::span<const Value> values,
                         std::span<const std::size_t> told, std::byte* at) noexcept {
  Writer writer(at);
  writer.number(is_parcel);
  writer.number(reinterpret_cast<std::uintptr_t>(parcel));
  writer.number(static_cast<std::uint32_t>(count));
  for (const std::size_t place : told) write(writer, values[place]);
  return writer.at();
}

Values decode_values(std::span<const std::byte> bytes, std::int64_t* birth, JavaArrays* arrays) {
  Reader reader(bytes);
  Values values;
  auto count = reader.number<std::uint32_t>();
  if (birth != nullptr && count == 0) throw ValueFormatError("there is no value, so no birth");
  for (; count > (birth != nullptr ? 1 : 0); --count) values.add(read(reader, arrays));
  if (birth != nullptr) {
    const Value last = read(reader, nullptr);
    const auto* number = std::get_if<std::int64_t>(&last);
    if (number == nullptr) throw ValueFormatError(std::string("the birth is a ") + kind_of(last));
    *birth = *number;
  }
  if (reader.left() > 0) throw ValueFormatError(std::to_string(reader.left()) + " bytes follow the last value");
  return values;
}

}  // namespace iotcloud::topology::storm
