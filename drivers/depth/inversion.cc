#include <algorithm>
#include <cstdlib>
#include <string_view>

#include <iotcloud/drivers/depth/inversion.h>
#include <iotcloud/drivers/depth/pixel_loop.h>

#if defined(__x86_64__)
#include <immintrin.h>
#define IOTCLOUD_HAS_AVX2
#endif

namespace iotcloud::drivers::depth {

namespace {

IOTCLOUD_PIXEL_LOOP void to_codes_portable(const std::uint16_t* disparities, const std::uint8_t* table,
                                           std::uint8_t* codes) {
  // The table's last entry is 0, so larger values become "no reading".
  for (std::size_t i = 0; i < frame_pixels; ++i) codes[i] = table[disparities[i] < 1023 ? disparities[i] : 1023];
}

IOTCLOUD_PIXEL_LOOP void to_mm_portable(const std::uint8_t* codes, const std::uint16_t* table, std::uint16_t* mm) {
  for (std::size_t i = 0; i < frame_pixels; ++i) mm[i] = table[codes[i]];
}

#ifdef IOTCLOUD_HAS_AVX2

/// code_table() with three bytes more: the gather instruction reads four bytes for each entry.
struct PaddedTable {
  alignas(64) std::array<std::uint8_t, 1024 + 3> codes{};
  PaddedTable() { std::copy(code_table().begin(), code_table().end(), codes.begin()); }
};

__attribute__((target("avx2"), always_inline)) inline __m256i eight_codes(const std::uint16_t* disparities,
                                                                          const std::uint8_t* table) {
  const __m128i values = _mm_min_epu16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(disparities)),
                                       _mm_set1_epi16(1023));  // its code is 0
  const __m256i found = _mm256_i32gather_epi32(reinterpret_cast<const int*>(table), _mm256_cvtepu16_epi32(values), 1);
  return _mm256_and_si256(found, _mm256_set1_epi32(0xff));
}

__attribute__((target("avx2"))) IOTCLOUD_PIXEL_LOOP void to_codes_avx2(const std::uint16_t* disparities,
                                                                       const std::uint8_t* table, std::uint8_t* codes) {
  // Packing works within halves of a register: this restores the order of their quarters.
  const __m256i order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
  for (std::size_t i = 0; i < frame_pixels; i += 32) {
    const std::uint16_t* from = disparities + i;
    const __m256i first = _mm256_packus_epi32(eight_codes(from, table), eight_codes(from + 8, table));
    const __m256i second = _mm256_packus_epi32(eight_codes(from + 16, table), eight_codes(from + 24, table));
    const __m256i all = _mm256_permutevar8x32_epi32(_mm256_packus_epi16(first, second), order);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(codes + i), all);
  }
}

/// trunc(90300 / (code + 21.575)) in single precision. The result for code 1 is exactly 4000 mm, which rounding would
/// lower to 3999; a dividend larger by 1/32 prevents that and changes no other code.
__attribute__((target("avx2"), always_inline)) inline __m256i eight_mm(__m256i codes) {
  const __m256 inverse = _mm256_add_ps(_mm256_cvtepi32_ps(codes), _mm256_set1_ps(21.575F));
  return _mm256_cvttps_epi32(_mm256_div_ps(_mm256_set1_ps(90300.03125F), inverse));
}

__attribute__((target("avx2"))) IOTCLOUD_PIXEL_LOOP void to_mm_avx2(const std::uint8_t* codes, std::uint16_t* mm) {
  for (std::size_t i = 0; i < frame_pixels; i += 16) {
    const __m128i sixteen = _mm_loadu_si128(reinterpret_cast<const __m128i*>(codes + i));
    const __m256i first = eight_mm(_mm256_cvtepu8_epi32(sixteen));
    const __m256i second = eight_mm(_mm256_cvtepu8_epi32(_mm_srli_si128(sixteen, 8)));
    const __m256i depths = _mm256_permute4x64_epi64(_mm256_packus_epi32(first, second), 0xd8);
    const __m256i none = _mm256_cmpeq_epi16(_mm256_cvtepu8_epi16(sixteen), _mm256_setzero_si256());
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(mm + i), _mm256_andnot_si256(none, depths));
  }
}

#endif

}  // namespace

bool runs_here(Path path) {
  if (path == Path::portable) return true;
#ifdef IOTCLOUD_HAS_AVX2
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

void to_codes([[maybe_unused]] Path path, FrameView disparities, std::uint8_t* codes) {
#ifdef IOTCLOUD_HAS_AVX2
  if (path == Path::avx2) {
    static const PaddedTable table;
    to_codes_avx2(disparities.data(), table.codes.data(), codes);
    return;
  }
#endif
  to_codes_portable(disparities.data(), code_table().data(), codes);
}

void to_mm([[maybe_unused]] Path path, const std::uint8_t* codes, FrameSpan mm) {
#ifdef IOTCLOUD_HAS_AVX2
  if (path == Path::avx2) {
    to_mm_avx2(codes, mm.data());
    return;
  }
#endif
  to_mm_portable(codes, mm_table().data(), mm.data());
}

}  // namespace iotcloud::drivers::depth
