#include <algorithm>
#include <bit>
#include <numeric>

#include <iotcloud/drivers/depth/entropy.h>

namespace iotcloud::drivers::depth::entropy {

Frequencies normalise(std::span<const std::uint32_t> counts) {
  const std::uint64_t total = std::accumulate(counts.begin(), counts.end(), std::uint64_t{0});
  Frequencies frequencies{};
  std::uint32_t sum = 0;
  for (std::size_t i = 0; i < counts.size(); ++i) {
    if (counts[i] == 0) continue;
    const std::uint64_t share = (counts[i] * std::uint64_t{scale} + total / 2) / total;
    frequencies[i] = static_cast<std::uint16_t>(std::max<std::uint64_t>(share, 1));
    sum += frequencies[i];
  }
  // The most frequent symbols absorb the rounding error: there it costs least.
  while (sum != scale) {
    auto& most = *std::max_element(frequencies.begin(), frequencies.end());
    if (sum < scale) {
      most = static_cast<std::uint16_t>(most + (scale - sum));
      sum = scale;
    } else {
      const std::uint32_t surplus = std::min<std::uint32_t>(sum - scale, most / 8U + 1);
      most = static_cast<std::uint16_t>(most - surplus);
      sum -= surplus;
    }
  }
  return frequencies;
}

void BitWriter::put(std::uint32_t value, int bits) {
  pending_ |= std::uint64_t{value} << pending_bits_;
  pending_bits_ += bits;
  for (; pending_bits_ >= 8; pending_bits_ -= 8) {
    bytes_.push_back(static_cast<std::byte>(pending_ & 0xff));
    pending_ >>= 8;
  }
}

void BitWriter::put_gamma(std::uint32_t value) {
  const int more = static_cast<int>(std::bit_width(value)) - 1;
  put(0, more);
  put(1, 1);
  put(value & ((1U << more) - 1), more);
}

void BitWriter::finish() {
  if (pending_bits_ > 0) put(0, 8 - pending_bits_);
}

std::uint32_t BitReader::get(int bits) {
  std::uint32_t value = 0;
  for (int i = 0; i < bits; ++i, ++position_) {
    if (position_ / 8 >= bytes_.size()) continue;
    value |= (std::to_integer<std::uint32_t>(bytes_[position_ / 8]) >> (position_ % 8) & 1) << i;
  }
  return value;
}

std::uint32_t BitReader::get_gamma() {
  int more = 0;
  while (get(1) == 0) {
    if (++more > scale_bits) return 0;
  }
  return 1U << more | get(more);
}

void write_table(BitWriter& writer, const Frequencies& frequencies, int symbols) {
  for (int i = 0; i < symbols;) {
    int zeros = 0;
    while (i + zeros < symbols && frequencies[i + zeros] == 0) ++zeros;
    writer.put_gamma(zeros + 1);
    i += zeros;
    if (i == symbols) break;
    writer.put_gamma(frequencies[i++]);
  }
}

bool read_table(BitReader& reader, Frequencies& frequencies, int symbols) {
  frequencies.fill(0);
  std::uint32_t sum = 0;
  for (int i = 0; i < symbols;) {
    const std::uint32_t zeros = reader.get_gamma();
    if (zeros == 0 || i + zeros - 1 > static_cast<std::uint32_t>(symbols)) return false;
    i += static_cast<int>(zeros) - 1;
    if (i == symbols) break;
    const std::uint32_t frequency = reader.get_gamma();
    if (frequency == 0 || frequency > scale) return false;
    frequencies[i++] = static_cast<std::uint16_t>(frequency);
    sum += frequency;
  }
  return sum == scale && !reader.overrun();
}

void fill(DecodingTable& table, const Frequencies& frequencies, std::span<const std::uint8_t, most_symbols> marks) {
  std::uint32_t* slot = table.data();
  for (std::uint32_t symbol = 0; symbol < most_symbols; ++symbol) {
    const std::uint32_t frequency = frequencies[symbol];
    const std::uint32_t entry = std::uint32_t{marks[symbol]} << 28 | symbol << 21 | frequency;
    for (std::uint32_t i = 0; i < frequency; ++i) *slot++ = entry | i << 11;
  }
}

}  // namespace iotcloud::drivers::depth::entropy
