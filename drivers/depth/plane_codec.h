#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/drivers/depth/entropy.h>
#include <iotcloud/drivers/depth/groups.h>

/// A plane as bytes and back (groups.h has the model): tables, then one stream of symbols.
namespace iotcloud::drivers::depth::groups {

/// So many steps a row takes at most: each group is an `other` one, and each of its pixels a literal.
template <typename Plane>
inline constexpr std::size_t most_row_steps = Rows<Plane>::row_groups*(1 + 2 * Plane::pixels);
/// A step moves 16 bits at most.
template <typename Plane>
inline constexpr std::size_t most_stream_bytes = most_row_steps<Plane>* frame_height * 2 + lanes * 4;

/// What is above the first row.
template <typename Plane>
inline constexpr auto no_row = [] {
  std::array<typename Plane::Value, frame_width> row{};
  row.fill(Plane::none);
  return row;
}();

/// Keeps its buffers (some 5 MB, of which a frame touches what it needs). Not thread safe.
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
  std::unique_ptr<std::uint32_t[]> steps_;  ///< in the order in which they are decoded
  std::uint32_t* steps_end_ = nullptr;
  std::unique_ptr<std::byte[]> stream_;
  std::array<std::array<std::uint32_t, entropy::most_symbols>, tables> counts_{};
  std::array<std::array<entropy::Share, entropy::most_symbols>, tables> shares_{};
};

/// Keeps its buffers (some 500 KB). Not thread safe.
template <typename Plane>
class PlaneDecoder {
 public:
  using Value = typename Plane::Value;
  PlaneDecoder();
  /// \param plane frame_pixels values. \return false for bytes that no PlaneEncoder wrote; then `plane` holds anything.
  /// Whatever the bytes are, nothing outside them and the plane is touched.
  bool decode(std::span<const std::byte> bytes, Value* plane);

 private:
  /// One lane's place in the stream, handed from step to step by value so that it stays in registers.
  struct Place {
    std::uint32_t state;
    const std::byte* next;
  };
  bool read_tables(entropy::BitReader& reader);
  bool begin_stream(std::span<const std::byte> stream);
  void decode_row(Value* row, const Value* row_above);
  Place decode_other(Place place, Value* row, const Value* row_above, std::size_t at, bool lane_begins);

  Rows<Plane> rows_;
  std::unique_ptr<entropy::DecodingTable[]> tables_;  ///< one more, which says that there is nothing
  std::array<const entropy::DecodingTable*, tables> table_of_{};
  std::unique_ptr<std::byte[]> stream_;
  const std::byte* stream_end_ = nullptr;
  std::array<std::uint32_t, lanes> states_{};
  const std::byte* next_ = nullptr;
};

}  // namespace iotcloud::drivers::depth::groups
