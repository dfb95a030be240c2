#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace iotcloud::drivers::modbus {

/// The four tables of a Modbus device.
enum class Table { coil, discrete, input, holding };

/// What the words of a register are.
enum class Type { boolean, uint16, int16, uint32, int32, uint64, int64, float32, float64 };

/// A value of a register: a bit, a whole number that is not scaled, or any other number.
using Value = std::variant<bool, std::int64_t, std::uint64_t, double>;

/// A value that a device has under one name.
struct Register {
  std::string name;
  Table table = Table::holding;
  int address = 0;
  Type type = Type::uint16;
  /// The order of a value's bytes on the wire: abcd (the largest first), cdab, badc or dcba.
  bool swaps_words = false, swaps_bytes = false;
  double scale = 1, offset = 0;  ///< value = raw * scale + offset
  std::string unit;              ///< for people
  bool writable = false;
  double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();

  bool is_bit() const { return table == Table::coil || table == Table::discrete; }
  int words() const;
};

/// Reads a map: a list of {name, table, address, type, order, scale, offset, unit, writable, min, max}.
/// \throws std::invalid_argument that says which entry is wrong, with its line.
std::vector<Register> read_map(const std::string& yaml);

/// Neighbours in one table that one request reads.
struct Group {
  Table table = Table::holding;
  int first = 0, count = 0;
  std::vector<std::size_t> registers;  ///< their places in the map
};

/// The requests that read all registers.
std::vector<Group> groups_of(const std::vector<Register>& map);

/// \param words as many as the register has.
Value decode(const Register& reg, std::span<const std::uint16_t> words);
/// The words of a value that somebody wants to write. \throws std::invalid_argument when it is out of range
std::vector<std::uint16_t> encode(const Register& reg, double value);

}  // namespace iotcloud::drivers::modbus
