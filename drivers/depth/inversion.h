#pragma once

#include <cstdint>

#include <iotcloud/drivers/depth/depth_codec.h>

/// The inversion step and its reverse over a whole frame, in two ways that give the same bytes: `portable` looks up one
/// pixel at a time, `avx2` handles 32 (disparities) or 16 (codes) at a time.
namespace iotcloud::drivers::depth {

enum class Path { portable, avx2 };

/// True if this machine can run `path`.
bool runs_here(Path path);
/// The fastest path of this machine, determined once; `portable` if the environment has IOTCLOUD_PORTABLE=1. Thread
/// safe.
Path best_path();

/// \param codes frame_pixels bytes. Thread safe.
void to_codes(Path path, FrameView disparities, std::uint8_t* codes);
/// \param codes frame_pixels bytes. Thread safe.
void to_mm(Path path, const std::uint8_t* codes, FrameSpan mm);

}  // namespace iotcloud::drivers::depth
