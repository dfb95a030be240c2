#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>

/// Recorded depth, in the format of libfreenect's replay (fakenect): a folder with a file for each frame,
/// d-<seconds>-<stamp>.pgm ("P5 640 480 65535\n" and little-endian disparities), and INDEX.txt, which lists their names
/// in order, one a line. A name may occur several times: its frame then repeats.
namespace iotcloud::drivers::turtle::recording {

struct RecordedFrame {
  std::string file;         ///< in the recording's folder
  double seconds = 0;       ///< when it was captured, on any clock; a smaller value than before begins a new round
  std::uint32_t stamp = 0;  ///< the device's time stamp
};

/// A recording on disk, read frame by frame. Not thread safe.
class Recording {
 public:
  /// Reads the index and skips names of other sensors (colour, accelerometer).
  /// \throws std::runtime_error that says what is wrong where, also if the index has no depth frame.
  explicit Recording(std::filesystem::path folder);

  const std::filesystem::path& folder() const { return folder_; }
  const std::vector<RecordedFrame>& frames() const { return frames_; }
  /// The time from a frame to the next; after the last frame comes the first. Never negative: where time goes back, the
  /// last interval before that counts.
  std::chrono::microseconds interval_after(std::size_t frame) const;
  /// \throws std::runtime_error that names the file if it is not a frame.
  void read(std::size_t frame, depth::FrameSpan disparities) const;

 private:
  std::filesystem::path folder_;
  std::vector<RecordedFrame> frames_;
};

/// Writes a recording that is complete after each frame, even if the program is killed. Not thread safe.
class RecordingWriter {
 public:
  /// Makes the folder. \throws std::runtime_error if it cannot, or if the folder has a recording already.
  explicit RecordingWriter(std::filesystem::path folder);
  /// \param seconds since the first frame. \throws std::runtime_error if the disk refuses the frame, which then is not
  /// in the index.
  void add(depth::FrameView disparities, double seconds);
  std::uint64_t frames() const { return frames_; }

 private:
  std::filesystem::path folder_;
  std::ofstream index_;
  std::uint64_t frames_ = 0;
};

}  // namespace iotcloud::drivers::turtle::recording
