#include <atomic>
#include <filesystem>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/process_watch.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::processes {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

constexpr int many = 8000;  ///< frames of a kilobyte, which no socket holds

/// A process that hears something, then says much without reading on, and then reads all.
constexpr const char* talker = R"(
import socket, struct, sys
def frame(body): return struct.pack(">I", len(body)) + body
with socket.socket(socket.AF_UNIX) as listener:
    listener.bind(sys.argv[1])
    listener.listen()
    peer, _ = listener.accept()
many = int(sys.argv[2])
heard = len(peer.recv(1))
peer.sendall(frame(b"x" * 1000) * many)
while heard < 1004 * many:
    heard += len(peer.recv(65536))
peer.sendall(frame(b"heard all"))
peer.recv(1)
)";

TEST(ProcessWatchTest, HearsAProcessThatSaysMuchBeforeItReadsWhatItIsTold) {
  std::string pattern = fs::temp_directory_path() / "iotcloud-watch-XXXXXX";
  const fs::path folder = mkdtemp(pattern.data());
  std::atomic<int> heard{0};
  std::atomic<bool> heard_all{false};
  config::Mutex mutex;
  std::string end;
  {
    ProcessWatch::Options options;
    options.folder = folder;
    options.socket = "talker.sock";
    options.hang_limit = tests::patience;
    ProcessWatch watch(
        options,
        ChildProcess(spawn({"/usr/bin/python3", "-c", talker, folder / "talker.sock", std::to_string(many)},
                           folder / "talker.log"),
                     true),
        {[&](const std::string& body) {
           ++heard;
           heard_all = body == "heard all";
         },
         [] {},
         [&](const WatchedEnd& how) {
           const config::MutexLock lock(mutex);
           end = how.killed + how.how;
         }});
    for (int i = 0; i < many; ++i) watch.send(frame(std::string(1000, 'y')));
    EXPECT_TRUE(tests::eventually([&] {
      const config::MutexLock lock(mutex);
      return heard_all || !end.empty();
    }));
    const config::MutexLock lock(mutex);
    EXPECT_EQ(end, "");
    EXPECT_EQ(heard, many + 1);
  }
  fs::remove_all(folder);
}

}  // namespace
}  // namespace iotcloud::processes
