#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/drivers/depth/entropy.h>
#include <iotcloud/drivers/depth/groups.h>

/// Encodes a plane to bytes and back (groups.h has the model): tables, then one stream of symbols.
namespace iotcloud::drivers::depth::groups {

/// Most steps of a row: each group is an `other` one, and each of its pixels a literal.
template <typename Plane>
inline constexpr std::size_t most_row_steps = Rows<Plane>::row_groups*(1 + 2 * Plane::pixels);
/// Each step takes at most 16 bits.
template <typename Plane>
inline constexpr std::size_t most_stream_bytes = most_row_steps<Plane>* frame_height * 2 + lanes * 4;

/// The row above the first row: no readings.
template <typename Plane>
inline constexpr auto no_row = [] {
  std::array<typename Plane::Value, frame_width> row{};
  row.fill(Plane::none);
  return row;
}();

/// The table of a pixel's symbol: it depends on which of its neighbours have a reading. \param left_read of the pixel
/// before it in the lane.
template <typename Plane>
std::uint32_t pixel_table(const typename Plane::Value* row_above, std::size_t at, bool left_read) {
  const bool above_read = row_above[at] != Plane::none;
  const bool right_read = at + 1 < frame_width && row_above[at + 1] != Plane::none;
  return static_cast<std::uint32_t>(first_pixel_table) + 4 * right_read + 2 * above_read + left_read;
}

/// Reuses its buffers (some 5 MB, of which a frame touches what it needs). Not thread safe.
template <typename Plane>
class PlaneEncoder {
 public:
  using Value = typename Plane::Value;
  PlaneEncoder();
  /// Appends the plane to `out`. \param plane frame_pixels values, of value_bits at most.
  void encode(const Value* plane, std::vector<std::byte>& out);

 private:
  void model(const Value* plane);
  void model_row(const Value* row, const Value* row_above);
  void model_other(const Value* row, const Value* row_above, std::size_t at, std::uint32_t lane, bool lane_begins);
  void note(std::uint32_t lane, std::uint32_t table, std::uint32_t symbol);
  void write_tables(std::vector<std::byte>& out);
  void write_symbols(std::vector<std::byte>& out);

  Rows<Plane> rows_;
  std::unique_ptr<std::uint32_t[]> steps_;  ///< in the order in which a decoder reads them
  std::uint32_t* steps_end_ = nullptr;
  std::unique_ptr<std::byte[]> stream_;
  std::array<std::array<std::uint32_t, entropy::most_symbols>, tables> counts_{};
  std::array<std::array<entropy::Share, entropy::most_symbols>, tables> shares_{};
};

/// Reuses its buffers (some 500 KB). Not thread safe.
template <typename Plane>
class PlaneDecoder {
 public:
  using Value = typename Plane::Value;
  PlaneDecoder();
  /// \param plane receives frame_pixels values. \return false for bytes that no PlaneEncoder wrote; then `plane` holds
  /// anything. Whatever the bytes are, decode() touches nothing outside them and the plane.
  bool decode(std::span<const std::byte> bytes, Value* plane);

 private:
  /// A lane's place in the stream, passed by value from step to step so that it stays in registers.
  struct Place {
    std::uint32_t state;
    const std::byte* next;
  };
  bool read_tables(entropy::BitReader& reader);
  bool begin_stream(std::span<const std::byte> stream);
  void decode_row(Value* row, const Value* row_above);
  Place decode_other(Place place, Value* row, const Value* row_above, std::size_t at, bool lane_begins);

  Rows<Plane> rows_;
  /// `tables` of them, and one more for tables that the frame does not use
  std::unique_ptr<entropy::DecodingTable[]> tables_;
  std::array<const entropy::DecodingTable*, tables> table_of_{};
  std::unique_ptr<std::byte[]> stream_;
  const std::byte* stream_end_ = nullptr;
  std::array<std::uint32_t, lanes> states_{};
  const std::byte* next_ = nullptr;
};

}  // namespace iotcloud::drivers::depth::groups
