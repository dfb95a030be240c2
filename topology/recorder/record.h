#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/recording/recording.h>
#include <iotcloud/topology/recorder/system.h>

namespace iotcloud::recorder {

/// What a Recorder records.
struct RecordOptions {
  std::string file{};
  recording::RecordingWriter::Options writing{};
  discovery::Selection where{};         ///< which driver instances, also those that come later
  std::vector<std::string> channels{};  ///< names of channels; empty: all
  bool out = true;                      ///< channels from drivers
  bool in = false;                      ///< channels to drivers
  /// Who reads at the brokers: each group gets every message. Empty: a new one. A recording of a group whose recorder
  /// was killed goes on, in another file, with what has waited meanwhile, if its queues are still there.
  std::string group{};
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
};

/// Records channels of a running system: reads each as a topology does, in a group of its own, so that nothing is taken
/// from anybody. A message is settled when its chunk is in the file; when the disk is slow, brokers hold messages back.
/// Thread safe.
class Recorder {
 public:
  struct Progress {
    std::size_t channels = 0;   ///< that are read
    std::size_t listening = 0;  ///< of them, those whose broker hands over every message from now on
    std::uint64_t messages = 0;
    std::uint64_t redelivered = 0;        ///< of them, those that a broker may have handed over before
    std::uint64_t bytes = 0;              ///< of the file
    std::string failure{};                ///< why it has ended by itself; empty: it goes on
    std::vector<std::string> troubles{};  ///< channels that cannot be read, and brokers that are away
  };

  /// Makes the file, and begins. \param on_message called when there may be progress that somebody waits for; from any
  /// thread; may be empty. \throws recording::RecordingError, config::Error.
  Recorder(System& system, RecordOptions options, std::function<void()> on_message = {});
  /// Ends without the file's end if close() was not called.
  ~Recorder();

  const std::string& group() const;
  /// To be called about once a second: writes what has come, so that it survives the process.
  void tick();
  Progress progress() const;
  /// Stops reading, removes its queues at the brokers, and writes the file's end. \throws recording::RecordingError.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::recorder
