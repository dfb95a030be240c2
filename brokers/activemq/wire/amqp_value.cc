#include "iotcloud/brokers/activemq/wire/amqp_value.h"

#include <bit>

namespace iotcloud::brokers::activemq {
namespace {

using Kind = AmqpValue::Kind;

// Limit on nested described values within descriptors.
constexpr int deepest = 8;
constexpr std::uint8_t described = 0x00;

AmqpValue number_value(Kind kind, std::uint64_t number) {
  AmqpValue value;
  value.kind = kind;
  value.number = number;
  return value;
}

AmqpValue bytes_value(Kind kind, std::string_view bytes) {
  AmqpValue value;
  value.kind = kind;
  value.bytes = bytes;
  return value;
}

std::uint64_t widened(std::uint64_t number, std::size_t width) {
  const unsigned unused = 64 - 8 * static_cast<unsigned>(width);
  return static_cast<std::uint64_t>(static_cast<std::int64_t>(number << unused) >> unused);
}

/// The width of the data after this constructor; for kinds with a length prefix, the prefix's width.
std::size_t width_of(std::uint8_t code) {
  switch (code >> 4U) {
    case 0x4:
      return 0;
    case 0x5:
    case 0xa:
    case 0xc:
    case 0xe:
      return 1;
    case 0x6:
      return 2;
    case 0x7:
    case 0xb:
    case 0xd:
    case 0xf:
      return 4;
    case 0x8:
      return 8;
    case 0x9:
      return 16;
    default:
      throw MalformedAmqp("an unknown type");
  }
}

}  // namespace

std::string_view AmqpReader::take(std::size_t count) {
  if (count > rest_.size()) throw MalformedAmqp("a value is longer than the message");
  const std::string_view taken = rest_.substr(0, count);
  rest_.remove_prefix(count);
  return taken;
}

std::uint64_t AmqpReader::take_number(std::size_t width) {
  std::uint64_t number = 0;
  for (const char byte : take(width)) number = number << 8U | static_cast<std::uint8_t>(byte);
  return number;
}

AmqpValue AmqpReader::read() {
  return read(0);
}

std::uint64_t AmqpReader::read_descriptor() {
  if (take_number(1) != described) throw MalformedAmqp("a section without a descriptor");
  const AmqpValue descriptor = read(1);
  return descriptor.kind == Kind::unsigned_number ? descriptor.number : 0;
}

AmqpValue AmqpReader::read(int depth) {
  if (depth > deepest) throw MalformedAmqp("values are nested too deeply");
  const auto code = static_cast<std::uint8_t>(take_number(1));
  if (code == described) {
    read(depth + 1);
    read(depth + 1);
    return number_value(Kind::other, 0);
  }
  const std::size_t width = width_of(code);
  if (code >= 0xa0) {  // a length prefix, then that many bytes
    std::string_view bytes = take(take_number(width));
    switch (code) {
      case 0xa0:
      case 0xb0:
        return bytes_value(Kind::binary, bytes);
      case 0xa1:
      case 0xa3:
      case 0xb1:
      case 0xb3:
        return bytes_value(Kind::text, bytes);
      case 0xc0:
      case 0xc1:
      case 0xd0:
      case 0xd1: {
        AmqpReader inside(bytes);
        AmqpValue value;
        value.kind = (code & 0xfU) == 0 ? Kind::list : Kind::map;
        value.elements = inside.take_number(width);
        value.bytes = inside.rest_;
        if (value.elements > value.bytes.size()) throw MalformedAmqp("fewer elements than it says");
        if (value.kind == Kind::map && value.elements % 2 != 0) throw MalformedAmqp("a key without a value");
        return value;
      }
      case 0xe0:
      case 0xf0:
        return number_value(Kind::other, 0);
      default:
        throw MalformedAmqp("an unknown type");
    }
  }
  const std::uint64_t number = width <= 8 ? take_number(width) : take(width).size();
  switch (code) {
    case 0x40:
      return {};
    case 0x41:
      return number_value(Kind::boolean, 1);
    case 0x42:
      return number_value(Kind::boolean, 0);
    case 0x56:
      return number_value(Kind::boolean, number != 0 ? 1 : 0);
    case 0x43:
    case 0x44:
    case 0x50:
    case 0x52:
    case 0x53:
    case 0x60:
    case 0x70:
    case 0x80:
      return number_value(Kind::unsigned_number, number);
    case 0x51:
    case 0x54:
    case 0x55:
    case 0x61:
    case 0x71:
    case 0x81:
      return number_value(Kind::signed_number, widened(number, width));
    case 0x83:
      return number_value(Kind::timestamp, number);
    case 0x72: {
      AmqpValue value = number_value(Kind::single_real, 0);
      value.real = std::bit_cast<float>(static_cast<std::uint32_t>(number));
      return value;
    }
    case 0x82: {
      AmqpValue value = number_value(Kind::double_real, 0);
      value.real = std::bit_cast<double>(number);
      return value;
    }
    case 0x45:
      return bytes_value(Kind::list, {});
    case 0x73:
    case 0x74:
    case 0x84:
    case 0x94:
    case 0x98:
      return number_value(Kind::other, 0);
    default:
      throw MalformedAmqp("an unknown type");
  }
}

void AmqpWriter::big_endian(std::uint32_t value) {
  for (unsigned shift = 32; shift > 0; shift -= 8) out_ += static_cast<char>(value >> (shift - 8) & 0xffU);
}

void AmqpWriter::octet(std::uint8_t value) {
  out_ += '\x50';
  out_ += static_cast<char>(value);
}

void AmqpWriter::number(std::uint32_t value) {
  out_ += '\x70';
  big_endian(value);
}

void AmqpWriter::text(std::string_view value) {
  if (value.size() < 256) {
    out_ += '\xa1';
    out_ += static_cast<char>(value.size());
  } else {
    out_ += '\xb1';
    big_endian(static_cast<std::uint32_t>(value.size()));
  }
  out_ += value;
}

void AmqpWriter::binary_head(std::size_t size) {
  if (size < 256) {
    out_ += '\xa0';
    out_ += static_cast<char>(size);
  } else {
    out_ += '\xb0';
    big_endian(static_cast<std::uint32_t>(size));
  }
}

void AmqpWriter::descriptor(std::uint8_t code) {
  out_ += '\0';
  out_ += '\x53';
  out_ += static_cast<char>(code);
}

std::size_t AmqpWriter::begin_list() {
  out_ += '\xd0';
  out_.append(8, '\0');
  return out_.size();
}

std::size_t AmqpWriter::begin_map() {
  out_ += '\xd1';
  out_.append(8, '\0');
  return out_.size();
}

void AmqpWriter::end(std::size_t begun, std::size_t elements) {
  const auto put = [&](std::size_t at, std::size_t value) {
    for (unsigned i = 0; i < 4; ++i) out_[at + i] = static_cast<char>(value >> (24 - 8 * i) & 0xffU);
  };
  put(begun - 8, out_.size() - begun + 4);
  put(begun - 4, elements);
}

}  // namespace iotcloud::brokers::activemq
