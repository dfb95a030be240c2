#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::drivers::turtle::recording {

enum class Unit { mm, disparity };

/// Lists a folder's depth images (.pgm and .png, also in capitals) by name, numbers in names by value: frame2 before
/// frame10. \throws std::runtime_error if there are no images or no such folder.
std::vector<std::filesystem::path> find_images(const std::filesystem::path& folder);

/// Reads a grey image of 640x480 pixels and 16 bits as disparities: binary PGM (big-endian, as the format demands) or
/// PNG. \throws std::runtime_error that names the file and what is wrong with it, such as its size.
void read_image(const std::filesystem::path& file, Unit unit, depth::FrameSpan disparities);

}  // namespace iotcloud::drivers::turtle::recording
