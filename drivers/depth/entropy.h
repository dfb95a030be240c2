#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

/// A range variant of asymmetric numeral systems (Duda 2013): a symbol of frequency f out of `scale` costs log2(scale /
/// f) bits, and the decoder reads first what the encoder wrote last. Each frame carries its tables.
namespace iotcloud::drivers::depth::entropy {

static_assert(std::endian::native == std::endian::little, "a stream's numbers have their lowest byte first");

inline constexpr int scale_bits = 10;
inline constexpr std::uint32_t scale = 1U << scale_bits;
inline constexpr int most_symbols = 84;  ///< most symbols of a table
/// A state is below this only within a step. An encoder begins with it, so a decoder must end with it.
inline constexpr std::uint32_t lowest_state = 1U << 16;

/// How often each symbol comes, in parts of `scale`; the parts add up to `scale`. All zero: the table is unused.
using Frequencies = std::array<std::uint16_t, most_symbols>;

/// Scales counts (not all zero) so that they add up to `scale` and each symbol that occurs keeps at least 1.
Frequencies normalise(std::span<const std::uint32_t> counts);

/// Appends bits to bytes, the lowest first.
class BitWriter {
 public:
  explicit BitWriter(std::vector<std::byte>& bytes) : bytes_(bytes) {}
  void put(std::uint32_t value, int bits);
  /// Writes a number from 1 on in Elias gamma code: 2n - 1 bits for a number of n bits.
  void put_gamma(std::uint32_t value);
  void finish();  ///< fills the last byte up

 private:
  std::vector<std::byte>& bytes_;
  std::uint64_t pending_ = 0;
  int pending_bits_ = 0;
};

/// Reads what a BitWriter wrote. Past the end it reads zeros, and overrun() is true.
class BitReader {
 public:
  explicit BitReader(std::span<const std::byte> bytes) : bytes_(bytes) {}
  std::uint32_t get(int bits);
  std::uint32_t get_gamma();  ///< 0 if no BitWriter writes these bits
  std::size_t bytes_read() const { return (position_ + 7) / 8; }
  bool overrun() const { return position_ > bytes_.size() * 8; }

 private:
  std::span<const std::byte> bytes_;
  std::size_t position_ = 0;  ///< in bits
};

void write_table(BitWriter& writer, const Frequencies& frequencies, int symbols);
/// \return false if the frequencies do not add up to `scale`, or if a symbol beyond `symbols` has one.
bool read_table(BitReader& reader, Frequencies& frequencies, int symbols);

/// For each of the `scale` remainders of a state, packed: the symbol's frequency (11 bits from bit 0), the distance
/// from the symbol's first remainder (10 bits), the symbol (7 bits) and its mark (the rest).
using DecodingTable = std::array<std::uint32_t, scale>;
/// \param marks four bits that get_symbol() returns with each symbol.
void fill(DecodingTable& table, const Frequencies& frequencies, std::span<const std::uint8_t, most_symbols> marks);

struct Symbol {
  std::uint32_t value, mark;
};
/// Decodes one symbol. It always reads 16 bits at `from`, but moves `from` past them only if the state needs them; the
/// caller must keep `from` within its buffer.
inline Symbol get_symbol(std::uint32_t& state, const DecodingTable& table, const std::byte*& from);
/// Decodes up to 16 bits that were written without a model.
inline std::uint32_t get_bits(std::uint32_t& state, int bits, const std::byte*& from);

namespace detail {

/// Has no branch: whether a state is low is as unpredictable as the coded data.
inline void refill(std::uint32_t& state, const std::byte*& from) {
  std::uint16_t next;
  std::memcpy(&next, from, sizeof next);
  const std::uint32_t low = state < lowest_state ? 1 : 0;
  state = state << (16 * low) | (next & (0 - low));
  from += sizeof next * low;
}

}  // namespace detail

inline Symbol get_symbol(std::uint32_t& state, const DecodingTable& table, const std::byte*& from) {
  const std::uint32_t entry = table[state & (scale - 1)];
  state = (entry & 0x7ff) * (state >> scale_bits) + (entry >> 11 & 0x3ff);
  detail::refill(state, from);
  return {entry >> 21 & 0x7f, entry >> 28};
}

inline std::uint32_t get_bits(std::uint32_t& state, int bits, const std::byte*& from) {
  const std::uint32_t value = state & ((1U << bits) - 1);
  state >>= bits;
  detail::refill(state, from);
  return value;
}

/// A symbol's part of `scale`.
struct Share {
  std::uint16_t first = 0, frequency = 0;
};

/// Writes backwards, from `end` down, because the decoder reads first what was written last.
class BackwardWriter {
 public:
  explicit BackwardWriter(std::byte* end) : position_(end) {}
  void put(std::uint32_t& state, Share share) {
    if (state >= std::uint64_t{share.frequency} << (32 - scale_bits)) spill(state);
    state = (state / share.frequency << scale_bits) + state % share.frequency + share.first;
  }
  void put_bits(std::uint32_t& state, std::uint32_t value, int bits) {
    if (state >= std::uint64_t{1} << (32 - bits)) spill(state);
    state = state << bits | value;
  }
  void put_state(std::uint32_t state) {
    for (const int shift : {16, 0}) put_half(state >> shift);
  }
  const std::byte* position() const { return position_; }

 private:
  void spill(std::uint32_t& state) {
    put_half(state);
    state >>= 16;
  }
  void put_half(std::uint32_t value) {
    *--position_ = static_cast<std::byte>(value >> 8 & 0xff);
    *--position_ = static_cast<std::byte>(value & 0xff);
  }
  std::byte* position_;
};

}  // namespace iotcloud::drivers::depth::entropy
