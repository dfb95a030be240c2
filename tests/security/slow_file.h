#pragma once

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <future>
#include <string>

#include <sys/stat.h>

namespace iotcloud::security::test {

/// Has two threads read a file again at the same time: the first one reads `before`, and is held up in that; meanwhile
/// the file becomes `after`, and the second thread reads it. Returns when both have.
/// \param reload reads the file once
inline void reload_around_a_change(const std::string& file, const std::string& before, const std::string& after,
                                   const std::function<void()>& reload) {
  std::filesystem::remove(file);
  mkfifo(file.c_str(), 0600);
  auto slow = std::async(std::launch::async, reload);
  std::ofstream pipe(file);  // is open once the slow thread has opened it
  std::ofstream(file + ".next") << after;
  std::filesystem::permissions(file + ".next", std::filesystem::perms::owner_read);
  std::filesystem::rename(file + ".next", file);
  auto fast = std::async(std::launch::async, reload);
  // If it does not wait for the slow one it is done now, and the slow one is the last.
  fast.wait_for(std::chrono::milliseconds(100));
  pipe << before << std::flush;
  pipe.close();
  slow.get();
  fast.get();
}

}  // namespace iotcloud::security::test
