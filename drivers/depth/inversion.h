#pragma once

#include <cstdint>

#include <iotcloud/drivers/depth/depth_codec.h>

/// The inversion step and its reverse over a whole frame, in two ways that give the same bytes: `portable` looks every
/// pixel up, `avx2` takes 32 and 16 at a time.
namespace iotcloud::drivers::depth {

enum class Path { portable, avx2 };

/// True when this machine can run `path`.
bool runs_here(Path path);
/// The fastest that runs here, found out once; `portable` when the environment has IOTCLOUD_PORTABLE=1. Thread safe.
Path best_path();

/// \param codes frame_pixels bytes. Thread safe.
void to_codes(Path path, FrameView disparities, std::uint8_t* codes);
/// \param codes frame_pixels bytes. Thread safe.
void to_mm(Path path, const std::uint8_t* codes, FrameSpan mm);

}  // namespace iotcloud::drivers::depth
