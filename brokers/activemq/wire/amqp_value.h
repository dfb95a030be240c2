#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// Bytes that are no AMQP 1.0.
class MalformedAmqp : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One AMQP 1.0 value as it stands on the wire. Refers to the bytes it was read from.
struct AmqpValue {
  enum class Kind {
    null,
    boolean,
    unsigned_number,
    signed_number,
    timestamp,
    single_real,
    double_real,
    binary,
    text,  ///< a string or a symbol
    list,
    map,
    other,  ///< what has no text here: arrays, decimals, characters, UUIDs, described values
  };
  Kind kind = Kind::null;
  std::uint64_t number = 0;  ///< of booleans and integers; signed ones and timestamps as two's complement
  double real = 0;
  std::string_view bytes;    ///< of binary and text; of lists and maps their elements, one after the other
  std::size_t elements = 0;  ///< of lists and maps (a map's keys and values, each)

  std::int64_t signed_number() const { return static_cast<std::int64_t>(number); }
};

/// Reads values one after the other. Trusts nothing: every length is checked, nesting is not followed unless asked for.
class AmqpReader {
 public:
  explicit AmqpReader(std::string_view bytes) : rest_(bytes) {}
  bool at_end() const { return rest_.empty(); }
  /// \throws MalformedAmqp
  AmqpValue read();
  /// Reads the descriptor in front of a described value. \return its code, or 0 when it is none that is a number.
  /// \throws MalformedAmqp when there is no descriptor
  std::uint64_t read_descriptor();

 private:
  AmqpValue read(int depth);
  std::string_view take(std::size_t count);
  std::uint64_t take_number(std::size_t width);

  std::string_view rest_;
};

/// Appends values to bytes.
class AmqpWriter {
 public:
  explicit AmqpWriter(std::string& out) : out_(out) {}
  void null() { out_ += '\x40'; }
  void boolean(bool value) { out_ += value ? '\x41' : '\x42'; }
  void octet(std::uint8_t value);
  void number(std::uint32_t value);
  void text(std::string_view value);
  /// The head of binary data; the bytes are to follow.
  void binary_head(std::size_t size);
  /// The descriptor of one of a message's sections.
  void descriptor(std::uint8_t code);
  /// Begins a list or a map; end() fills in how long it became.
  std::size_t begin_list();
  std::size_t begin_map();
  void end(std::size_t begun, std::size_t elements);

 private:
  void big_endian(std::uint32_t value);

  std::string& out_;
};

}  // namespace iotcloud::brokers::activemq
