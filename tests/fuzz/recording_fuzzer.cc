// A folder that somebody gives as a recording: the input is the length of the index in two bytes, the index, and the
// file of each frame that it names.
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <stdlib.h>

#include "iotcloud/drivers/depth/depth_codec.h"
#include "iotcloud/drivers/turtle/recording/recording.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace fs = std::filesystem;

namespace {

class RecordingFolder {
 public:
  RecordingFolder() {
    std::string name = (fs::exists("/dev/shm") ? "/dev/shm" : "/tmp") + std::string("/recording-fuzz-XXXXXX");
    fuzz::must(mkdtemp(name.data()) != nullptr, "there is a folder to work in");
    path_ = name;
  }
  RecordingFolder(const RecordingFolder&) = delete;
  RecordingFolder& operator=(const RecordingFolder&) = delete;
  ~RecordingFolder() { fs::remove_all(path_); }
  void clear() const {
    for (const auto& file : fs::directory_iterator(path_)) fs::remove(file.path());
  }
  void write(const std::string& name, std::string_view bytes) const { std::ofstream(path_ / name) << bytes; }
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(recording, 4'000) {
  namespace recording = drivers::turtle::recording;
  constexpr std::size_t most_frames = 20;  // that are read of one input
  static const RecordingFolder folder;
  static std::vector<std::uint16_t> pixels(drivers::depth::frame_pixels);
  if (size < 2) return;
  const std::string_view input = fuzz::text(data + 2, size - 2);
  const std::size_t length = data[0] + std::size_t{256} * data[1];
  folder.clear();
  folder.write("INDEX.txt", input.substr(0, length));
  try {
    const recording::Recording read(folder.path());
    const auto& frames = read.frames();
    fuzz::must(!frames.empty(), "a recording has frames");
    for (std::size_t i = 0; i < frames.size() && i < most_frames; ++i) {
      fuzz::must(read.interval_after(i).count() > 0, "time goes on");
      fuzz::must(fs::path(frames[i].file).filename() == frames[i].file, "a frame lies in the folder");
      folder.write(frames[i].file, input.substr(std::min(length, input.size())));
      try {
        read.read(i, drivers::depth::FrameSpan(pixels));
      } catch (const std::runtime_error&) {
        // No frame.
      }
    }
  } catch (const std::runtime_error&) {
    // No recording.
  }
}
