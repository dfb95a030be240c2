// A file that somebody gives as a recording (recording/mcap), of this project or another: read whole, twice, and
// checked.
#include <filesystem>
#include <fstream>
#include <string>

#include <stdlib.h>

#include "iotcloud/recording/recording.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

namespace {

/// A file that is gone with the process.
class OneFile {
 public:
  OneFile() {
    std::string name = (std::filesystem::exists("/dev/shm") ? "/dev/shm" : "/tmp") + std::string("/mcap-fuzz-XXXXXX");
    fuzz::must(mkdtemp(name.data()) != nullptr, "there is a folder to work in");
    folder_ = name;
  }
  ~OneFile() { std::filesystem::remove_all(folder_); }
  OneFile(const OneFile&) = delete;
  OneFile& operator=(const OneFile&) = delete;
  std::string write(std::string_view bytes) const {
    std::ofstream(folder_ / "a.mcap", std::ios::binary | std::ios::trunc) << bytes;
    return folder_ / "a.mcap";
  }

 private:
  std::filesystem::path folder_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(mcap, 4'000) {
  static const OneFile file;
  constexpr recording::mcap::Limits limits{
      .chunk = 1 << 20, .open_chunks = 4 << 20, .descriptions = 1 << 20, .chunks = 1000};
  const std::string path = file.write(fuzz::text(data, size));
  try {
    recording::RecordingReader reader(path, limits);
    std::size_t first = 0, second = 0;
    recording::Instant before{INT64_MIN};
    const bool whole = reader.file().whole();
    while (const auto message = reader.next()) {
      ++first;
      fuzz::must(message->channel < reader.channels().size(), "a message has a channel");
      fuzz::must(!whole || message->message.payload.size() <= limits.chunk, "a message lies in a chunk");
      before = message->at;
    }
    static_cast<void>(before);
    reader.rewind();
    while (reader.next()) ++second;
    fuzz::must(first == second, "each reading gives the same messages");
    reader.check();
  } catch (const recording::RecordingError&) {
    // No recording, or a damaged one.
  }
}
