#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <iotcloud/drivers/depth/depth_codec.h>

/// Recorded depth, in the format of libfreenect's replay (fakenect): a folder with a file for each frame,
/// d-<seconds>-<stamp>.pgm ("P5 640 480 65535\n" and little-endian disparities), and their names in order, one a line,
/// in INDEX.txt. A name may come again: the frame does.
namespace iotcloud::drivers::turtle::recording {

struct RecordedFrame {
  std::string file;         ///< in the recording's folder
  double seconds = 0;       ///< when it was taken, on any clock; a smaller one than before begins a new round
  std::uint32_t stamp = 0;  ///< of the device's clock
};

/// A recording on disk, read frame by frame. Not thread safe.
class Recording {
 public:
  /// Reads the index; names of other things than depth (colour, accelerometer) are passed over.
  /// \throws std::runtime_error that says what is wrong where, also for an index without depth.
  explicit Recording(std::filesystem::path folder);

  const std::filesystem::path& folder() const { return folder_; }
  const std::vector<RecordedFrame>& frames() const { return frames_; }
  /// From a frame to the one after it; after the last one comes the first again. Not negative, and the last interval
  /// that was none where time goes back.
  std::chrono::microseconds interval_after(std::size_t frame) const;
  /// \throws std::runtime_error that names the file when it is not a frame.
  void read(std::size_t frame, depth::FrameSpan disparities) const;

 private:
  std::filesystem::path folder_;
  std::vector<RecordedFrame> frames_;
};

/// Writes a recording, whole after each frame: a program that is killed leaves what it had. Not thread safe.
class RecordingWriter {
 public:
  /// Makes the folder. \throws std::runtime_error when it cannot, or when a recording is there already.
  explicit RecordingWriter(std::filesystem::path folder);
  /// \param seconds since the first frame. \throws std::runtime_error when the disk does not take it; the frame is not
  /// in the index then.
  void add(depth::FrameView disparities, double seconds);
  std::uint64_t frames() const { return frames_; }

 private:
  std::filesystem::path folder_;
  std::ofstream index_;
  std::uint64_t frames_ = 0;
};

}  // namespace iotcloud::drivers::turtle::recording
