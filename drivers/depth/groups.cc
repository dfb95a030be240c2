#include <iotcloud/drivers/depth/groups.h>

namespace iotcloud::drivers::depth::groups {

namespace {

/// Each step as a base-3 digit: 0 level, 1 up, 2 down.
inline std::uint32_t digits_of(std::uint32_t steps) {
  const std::uint32_t moves = (steps | ((steps & 0x7f7f7f7f) + 0x7f7f7f7f)) >> 7;
  return (moves & CodePlane::low_bits) + (steps >> 7 & CodePlane::low_bits);
}

IOTCLOUD_PIXEL_LOOP void classify_read(const std::uint8_t* above, std::size_t groups, std::uint8_t* classes) {
  for (std::size_t g = 0; g < groups; ++g) {
    const std::uint8_t* pixels = above + g * CodePlane::pixels;
    const std::uint32_t digits = digits_of(subtract<CodePlane>(load(pixels), load(pixels - 1)));
    classes[g] = static_cast<std::uint8_t>(digits * CodePlane::weights >> CodePlane::weight_shift);
  }
}

IOTCLOUD_PIXEL_LOOP void classify_read(const std::uint16_t* above, std::size_t groups, std::uint8_t* classes) {
  constexpr int farthest = 1;  // the largest step that a class tells apart, up or down
  std::array<std::uint16_t, frame_width> digits;
  for (int i = 0; i < static_cast<int>(frame_width); ++i) {
    const auto step = static_cast<std::int16_t>(above[i] - above[i - 1]);
    digits[i] = static_cast<std::uint16_t>((step < -farthest  ? -farthest
                                            : step > farthest ? farthest
                                                              : step) +
                                           farthest);
  }
  for (std::size_t g = 0; g < groups; ++g) {
    const std::uint32_t group = load(digits.data() + g * DisparityPlane::pixels);
    classes[g] = static_cast<std::uint8_t>(group * DisparityPlane::weights >> DisparityPlane::weight_shift);
  }
}

}  // namespace

template <typename Plane>
IOTCLOUD_PIXEL_LOOP void Rows<Plane>::classify() {
  Value* row = rows_[upper_].data() + margin;
  row[-1] = row[0];
  kinds_[row_groups] = none;
  classify_read(row, row_groups, classes_.data());
  // Has no branches: whether a group has readings is hard to predict.
  for (int g = 0; g < row_groups; ++g) {
    const int edge = kinds_[g + 1] == none ? above_none : above_none_to_the_right;
    const int lacking = kinds_[g] == other ? above_other : edge;
    classes_[g] = static_cast<std::uint8_t>(kinds_[g] == read ? classes_[g] : lacking);
  }
}

template <typename Plane>
Rises<Plane>::Rises() {
  constexpr int values = 2 * Plane::reach + 1;
  for (std::uint32_t symbol = 0; symbol < none_symbol; ++symbol) {
    std::array<typename Plane::Value, Plane::pixels> rises{};
    int rest = static_cast<int>(symbol), last = 0;
    for (auto& rise : rises) {
      last = rest % values - Plane::reach;
      rise = static_cast<typename Plane::Value>(last);
      rest /= values;
    }
    group[symbol] = load(rises.data());
    left[symbol] = static_cast<std::uint8_t>(last < 0 ? left_lower : last > 0 ? left_higher : left_same);
  }
  left[none_symbol] = left[other_symbol] = left_unknown;
}

template <typename Plane>
const Rises<Plane>& Rises<Plane>::shared() {
  static const Rises rises;
  return rises;
}

template class Rows<CodePlane>;
template class Rows<DisparityPlane>;
template struct Rises<CodePlane>;
template struct Rises<DisparityPlane>;

}  // namespace iotcloud::drivers::depth::groups
