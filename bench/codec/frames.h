#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

namespace iotcloud::bench {

/// 640 x 480 disparities of a Kinect, row by row.
using Frame = std::vector<std::uint16_t>;

/// Simulated frames of a Kinect whose robot follows a walking person: `each` frames, one a second, of each of
/// `worlds` worlds (seeds 1, 2, ...).
std::vector<Frame> simulated_frames(int worlds, int each);

/// The depth images of a folder (binary PGM, 640 x 480, 16 bits, millimetres; .pgm or .pgm.gz), by name, as the nearest
/// disparities. \throws std::runtime_error that names the file and says what is wrong.
std::vector<Frame> frames_of_folder(const std::filesystem::path& folder);

/// A benchmark's main(): reads its command line (its `usage` explains it), loads the frames and calls `run` with the
/// number of rounds.
int run_on_frames(int argc, char** argv, const std::function<int(const std::vector<Frame>& frames, int rounds)>& run);

}  // namespace iotcloud::bench
