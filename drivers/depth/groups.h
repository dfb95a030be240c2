#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/depth/entropy.h>
#include <iotcloud/drivers/depth/pixel_loop.h>

/// The model of a plane (a frame of codes, or of disparities), used by both codecs but the reference. A row is cut into
/// groups of neighbouring pixels, 32 bits each. One symbol says how much each pixel of a group rises over the pixel
/// above it. Its context is how the row above runs there, and how the group to the left ended. Where a pixel has no
/// reading, the value above stands in for it, so that its neighbours have something to compare with.
///
/// A row's groups are coded in four lanes, one for each quarter of the row, in turns: so the lanes' chains of dependent
/// steps overlap.
namespace iotcloud::drivers::depth::groups {

static_assert(std::endian::native == std::endian::little, "the first pixel of a group is in its lowest bits");

inline constexpr std::uint32_t group_symbols = 83;
inline constexpr std::uint32_t none_symbol = 81;  ///< no pixel of the group has a reading
/// none of the other symbols fits; the group's pixels follow one by one
inline constexpr std::uint32_t other_symbol = 82;

/// Symbols for one pixel of an `other` group.
inline constexpr int pixel_symbols = 32;
inline constexpr std::uint32_t pixel_none = 0;     ///< no reading
inline constexpr std::uint32_t pixel_literal = 1;  ///< its value follows
inline constexpr int pixel_zero = 17;  ///< the value of the pixel to the left; symbols around this one: less, more
inline constexpr int pixel_reach = 14;

inline constexpr int lanes = 4;
inline constexpr int lane_width = frame_width / lanes;

/// Groups of four codes.
struct CodePlane {
  using Value = std::uint8_t;
  static constexpr int pixels = 4;
  static constexpr int reach = 1;  ///< 3^4 symbols for rises from -1 to 1
  static constexpr Value none = 0;
  static constexpr Value beginning = 100;  ///< stands above the first row
  static constexpr int value_bits = 8;
  static constexpr std::uint32_t low_bits = 0x01010101, high_bits = 0x80808080;
  static constexpr std::uint32_t in_reach = 0x02020202, weights = 0x0103091b;
  static constexpr int weight_shift = 24;
};

/// Groups of two disparities.
struct DisparityPlane {
  using Value = std::uint16_t;
  static constexpr int pixels = 2;
  static constexpr int reach = 4;  ///< 9^2 symbols for rises from -4 to 4
  static constexpr Value none = no_reading;
  static constexpr Value beginning = 700;
  static constexpr int value_bits = 11;
  static constexpr std::uint32_t low_bits = 0x00010001, high_bits = 0x80008000;
  static constexpr std::uint32_t in_reach = 0x00080008, weights = 0x00010009;
  static constexpr int weight_shift = 16;
};

/// Adds and subtracts all values of a group at once, each modulo its width.
template <typename Plane>
inline std::uint32_t add(std::uint32_t a, std::uint32_t b) {
  constexpr std::uint32_t high = Plane::high_bits;
  return ((a & ~high) + (b & ~high)) ^ ((a ^ b) & high);
}
template <typename Plane>
inline std::uint32_t subtract(std::uint32_t a, std::uint32_t b) {
  constexpr std::uint32_t high = Plane::high_bits;
  return ((a | high) - (b & ~high)) ^ ((a ^ ~b) & high);
}
template <typename Plane>
inline bool has_zero(std::uint32_t a) {
  return ((a - Plane::low_bits) & ~a & Plane::high_bits) != 0;
}

template <typename Value>
inline std::uint32_t load(const Value* from) {
  std::uint32_t group;
  std::memcpy(&group, from, sizeof group);
  return group;
}
template <typename Value>
inline void store(Value* to, std::uint32_t group) {
  std::memcpy(to, &group, sizeof group);
}

/// How a group was coded: part of the context of the groups below and to the right.
enum Kind : std::uint8_t { read = 0, none = 1, other = 2 };

// A context is a class of the row above combined with what the group to the left did. The class is how the row above
// runs (the step to each of the group's pixels from the pixel before it), or which readings it lacks.
inline constexpr int above_none = 81, above_none_to_the_right = 82, above_other = 83, above_classes = 84;
inline constexpr int left_lower = 0, left_same = 1, left_higher = 2, left_unknown = 3, left_classes = 4;
inline constexpr int contexts = above_classes * left_classes;
/// Rare contexts share a table. After it come the tables of single pixels, chosen by which of the pixels above, to the
/// left and above to the right have readings.
inline constexpr int shared_table = contexts;
inline constexpr int first_pixel_table = contexts + 1;
inline constexpr int tables = first_pixel_table + 8;
inline constexpr int symbols_of(int table) {
  return table < first_pixel_table ? group_symbols : pixel_symbols;
}

/// The two newest rows of a plane with gaps filled in, and how the groups of the upper row were coded.
template <typename Plane>
class Rows {
 public:
  using Value = typename Plane::Value;
  static constexpr int row_groups = static_cast<int>(frame_width) / Plane::pixels;
  static constexpr int lane_groups = row_groups / lanes;

  void begin() {
    for (Value& value : rows_[0]) value = Plane::beginning;
    kinds_.fill(none);
    upper_ = 0;
  }
  /// Finds the classes of the row above the next one.
  void classify();
  void next_row() { upper_ ^= 1; }

  const Value* above() const { return rows_[upper_].data() + margin; }
  Value* current() { return rows_[upper_ ^ 1].data() + margin; }
  std::uint8_t* kinds() { return kinds_.data(); }
  /// For each group, the class of the row above it.
  const std::uint8_t* classes() const { return classes_.data(); }

 private:
  static constexpr int margin = 4;
  std::array<std::array<Value, frame_width + margin>, 2> rows_{};
  int upper_ = 0;
  std::array<std::uint8_t, row_groups + 1> kinds_{};
  std::array<std::uint8_t, row_groups> classes_{};
};

/// For each symbol below none_symbol: how much the group's pixels rise, and the left context that its last pixel gives.
template <typename Plane>
struct Rises {
  std::array<std::uint32_t, none_symbol> group{};
  std::array<std::uint8_t, entropy::most_symbols> left{};
  Rises();
  static const Rises& shared();
};

extern template class Rows<CodePlane>;
extern template class Rows<DisparityPlane>;
extern template struct Rises<CodePlane>;
extern template struct Rises<DisparityPlane>;

}  // namespace iotcloud::drivers::depth::groups
