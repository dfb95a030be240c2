#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// The bytes are not valid AMQP 1.0.
class MalformedAmqp : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One AMQP 1.0 value. Refers to the bytes from which it was read.
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
    other,  ///< kinds without a text form: arrays, decimals, characters, UUIDs, described values
  };
  Kind kind = Kind::null;
  std::uint64_t number = 0;  ///< value of booleans and integers; signed ones and timestamps in two's complement
  double real = 0;
  std::string_view bytes;    ///< content of binary and text; of lists and maps the encoded elements
  std::size_t elements = 0;  ///< number of elements of lists and maps (keys and values count separately)

  std::int64_t signed_number() const { return static_cast<std::int64_t>(number); }
};

/// Reads one value after another. Checks every length, and does not follow nested values unless asked to.
class AmqpReader {
 public:
  explicit AmqpReader(std::string_view bytes) : rest_(bytes) {}
  bool at_end() const { return rest_.empty(); }
  /// \throws MalformedAmqp
  AmqpValue read();
  /// Reads the descriptor before a described value. \return its code, or 0 when it is not a number.
  /// \throws MalformedAmqp when there is no descriptor.
  std::uint64_t read_descriptor();

 private:
  AmqpValue read(int depth);
  std::string_view take(std::size_t count);
  std::uint64_t take_number(std::size_t width);

  std::string_view rest_;
};

/// Appends encoded values to a string.
class AmqpWriter {
 public:
  explicit AmqpWriter(std::string& out) : out_(out) {}
  void null() { out_ += '\x40'; }
  void boolean(bool value) { out_ += value ? '\x41' : '\x42'; }
  void octet(std::uint8_t value);
  void number(std::uint32_t value);
  void text(std::string_view value);
  /// Writes the head of binary data; the caller appends the bytes.
  void binary_head(std::size_t size);
  /// Writes the descriptor of a message section.
  void descriptor(std::uint8_t code);
  /// Begins a list or a map; end() fills in its length.
  std::size_t begin_list();
  std::size_t begin_map();
  void end(std::size_t begun, std::size_t elements);

 private:
  void big_endian(std::uint32_t value);

  std::string& out_;
};

}  // namespace iotcloud::brokers::activemq
