#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string_view>

#include <iotcloud/examples/turtlebot_follower/box_scan.h>

#if defined(__x86_64__)
#include <immintrin.h>
#define TURTLEBOT_HAS_AVX2
#endif

namespace turtlebot_follower {

namespace {

constexpr int columns_at_once = 16;

/// The smallest depth in [first, last + 1] at which `holds` is true; it must stay true for larger depths.
template <typename Condition>
int first_where(int first, int last, Condition holds) {
  int end = last + 1;
  while (first < end) {
    const int middle = (first + end) / 2;
    if (holds(middle)) {
      end = middle;
    } else {
      first = middle + 1;
    }
  }
  return first;
}

}  // namespace

/// The two loops over the rows of a frame; they read BoxScan's members.
struct BoxScanLoops {
  static void add_row(const BoxScan& scan, const BoxScan::Row& row, const std::uint16_t* depths, BoxScan::Sums& sums) {
    std::uint32_t points = 0, mm_sum = 0;
    std::int32_t weighted = 0;  // depths up to 10 000 and columns up to 320 from the centre use half of its range
    for (int u = row.first_column; u < row.end_column; ++u) {
      const std::uint16_t mm = depths[u];
      const std::uint16_t first = std::max(row.range.first, scan.column_first_[u]);
      const std::uint16_t last = std::min(row.range.last, scan.column_last_[u]);
      const int in_box = int{mm >= first} & int{mm <= last};
      const std::uint16_t kept = in_box != 0 ? mm : std::uint16_t{0};
      points += kept != 0;
      mm_sum += kept;
      weighted += std::int32_t{kept} * scan.column_weight_[u];
    }
    sums.points += points;
    sums.mm += mm_sum;
    sums.mm_times_column += weighted;
  }

#ifdef TURTLEBOT_HAS_AVX2
  __attribute__((target("avx2"), always_inline)) static inline __m256i load(const void* from) {
    return _mm256_loadu_si256(static_cast<const __m256i*>(from));
  }

  __attribute__((target("avx2"))) static std::int64_t sum_of(__m256i lanes) {
    alignas(32) std::array<std::int32_t, 8> values{};
    _mm256_store_si256(reinterpret_cast<__m256i*>(values.data()), lanes);
    std::int64_t sum = 0;
    for (const std::int32_t value : values) sum += value;
    return sum;
  }

  __attribute__((target("avx2"))) static void add_row_avx2(const BoxScan& scan, const BoxScan::Row& row,
                                                           const std::uint16_t* depths, BoxScan::Sums& sums) {
    const __m256i row_first = _mm256_set1_epi16(static_cast<std::int16_t>(row.range.first));
    const __m256i row_last = _mm256_set1_epi16(static_cast<std::int16_t>(row.range.last));
    const __m256i ones = _mm256_set1_epi16(1);
    __m256i points = _mm256_setzero_si256(), mm_sum = points, weighted = points;
    for (int u = row.first_column; u < row.end_column; u += columns_at_once) {
      const __m256i mm = load(depths + u);
      const __m256i first = _mm256_max_epu16(row_first, load(scan.column_first_.data() + u));
      const __m256i last = _mm256_min_epu16(row_last, load(scan.column_last_.data() + u));
      const __m256i near_enough = _mm256_cmpeq_epi16(_mm256_min_epu16(mm, last), mm);
      const __m256i in_box = _mm256_and_si256(near_enough, _mm256_cmpeq_epi16(_mm256_max_epu16(mm, first), mm));
      const __m256i kept = _mm256_and_si256(mm, in_box);
      points = _mm256_sub_epi16(points, in_box);  // at most 40 in a lane
      mm_sum = _mm256_add_epi32(mm_sum, _mm256_madd_epi16(kept, ones));
      weighted = _mm256_add_epi32(weighted, _mm256_madd_epi16(kept, load(scan.column_weight_.data() + u)));
    }
    sums.points += static_cast<std::uint32_t>(sum_of(_mm256_madd_epi16(points, ones)));
    sums.mm += sum_of(mm_sum);
    sums.mm_times_column += sum_of(weighted);
  }
#endif
};

bool runs_here(Path path) {
  if (path == Path::portable) return true;
#ifdef TURTLEBOT_HAS_AVX2
  return __builtin_cpu_supports("avx2") != 0;
#else
  return false;
#endif
}

Path best_path() {
  static const Path path = [] {
    const char* portable = std::getenv("IOTCLOUD_PORTABLE");
    const bool wanted = portable && std::string_view(portable) == "1";
    return wanted || !runs_here(Path::avx2) ? Path::portable : Path::avx2;
  }();
  return path;
}

/// The depths within `within` at which low < factor * z / f < high. The coordinate grows with depth, or falls if the
/// factor is negative: one condition holds from some depth on, the other up to some depth.
BoxScan::Range BoxScan::range_of(double factor, double low, double high, Range within) {
  const auto coordinate = [factor](int mm) { return factor * (mm / 1000.0) / focal_length; };
  const auto above_low = [&](int mm) { return low < coordinate(mm); };
  const auto below_high = [&](int mm) { return coordinate(mm) < high; };
  int first = 0, end = 0;
  if (factor < 0) {
    first = first_where(within.first, within.last, below_high);
    end = first_where(within.first, within.last, [&](int mm) { return !above_low(mm); });
  } else {
    first = first_where(within.first, within.last, above_low);
    end = first_where(within.first, within.last, [&](int mm) { return !below_high(mm); });
  }
  return {static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(end - 1)};
}

BoxScan::BoxScan(const Box& box) {
  const int farthest = static_cast<int>(farthest_box * 1000);
  const int first = first_where(1, farthest, [&](int mm) { return box.z_min < mm / 1000.0; });
  const int end = first_where(1, farthest, [&](int mm) { return !(mm / 1000.0 < box.z_max); });
  const Range all{static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(end - 1)};
  for (int u = 0; u < width; ++u) {
    const Range range = range_of(u - centre_u, box.x_min, box.x_max, all);
    column_first_[u] = range.first;
    column_last_[u] = range.last;
    column_weight_[u] = static_cast<std::int16_t>(u - centre_u);
  }
  for (int v = 0; v < height; ++v) {
    Row& row = rows_[v];
    row.range = range_of(v - centre_v, box.y_min, box.y_max, all);
    for (int u = 0; u < width; ++u) {
      if (std::max(row.range.first, column_first_[u]) > std::min(row.range.last, column_last_[u])) continue;
      if (row.end_column == 0) row.first_column = u / columns_at_once * columns_at_once;
      row.end_column = (u / columns_at_once + 1) * columns_at_once;
    }
  }
}

BoxScan::Sums BoxScan::add_up(const std::uint16_t* depth_mm, [[maybe_unused]] Path path) const {
  Sums sums;
  for (const Row& row : rows_) {
    const std::uint16_t* depths = depth_mm;
    depth_mm += width;
    if (row.end_column == 0) continue;
#ifdef TURTLEBOT_HAS_AVX2
    if (path == Path::avx2) {
      BoxScanLoops::add_row_avx2(*this, row, depths, sums);
      continue;
    }
#endif
    BoxScanLoops::add_row(*this, row, depths, sums);
  }
  return sums;
}

}  // namespace turtlebot_follower
