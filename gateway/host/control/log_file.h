#pragma once

#include <cstdint>
#include <string>

namespace iotcloud::gateway {

/// Keeps the file to which this process's stdout and stderr go within bounds: when it has grown past the limit it
/// becomes <path>.1, what was that <path>.2 and so on, and a new one is begun. Nothing that is written meanwhile is
/// lost. Several processes may write into one file: one of them moves it, the others follow. Used on one thread.
class LogFile {
 public:
  struct Options {
    std::string path;  ///< empty: there is none, look() does nothing
    std::uint64_t most_bytes = std::uint64_t{10} << 20;
    int kept = 3;  ///< older ones, besides the one that is written
  };
  explicit LogFile(Options options) : options_(std::move(options)) {}

  /// Looks once; call it every few seconds.
  void look() const;

 private:
  void follow() const;

  const Options options_;
};

/// Moves a log that has grown past its limit: <path> becomes <path>.1 and so on. `written` is an open descriptor of it,
/// whose lock decides which of several processes does it; it keeps the lock until it is closed. Nothing happens when
/// the log is not there any more, or may not be moved. \return whether it was moved.
bool move_log(const LogFile::Options& options, int written);

}  // namespace iotcloud::gateway
