#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/recording/player.h>
#include <iotcloud/topology/recorder/system.h>

namespace iotcloud::recorder {

/// What is played of a recording, and how.
struct PlayOptions {
  double speed = 1;  ///< 2: twice as fast; 0: as fast as the channels take it
  bool loop = false;
  bool times_now = false;                ///< messages get the present time, and not the recorded one
  std::vector<std::string> instances{};  ///< ids, their beginnings, or names; empty: all
  std::vector<std::string> channels{};   ///< empty: all
  bool in = false;                       ///< also channels to drivers
  /// Recorded instances by id, its beginning or name, and the instance of the running system in the place of each.
  std::map<std::string, std::string> to{};
};

/// What became of the messages of a play.
struct PlayResult {
  recording::Played played{};
  std::uint64_t confirmed = 0;                    ///< the broker has them
  std::map<std::string, std::uint64_t> others{};  ///< by what became of them
};

/// Which channels of the recording the options choose. \throws config::Error when an instance or channel is named that
/// was not recorded, or nothing is left.
std::vector<bool> chosen_channels(const recording::RecordingReader& recording, const PlayOptions& options);

/// Plays into a running system: sends on the channels of its driver instances, as if they had sent the messages. The
/// recorded instance's place takes the one of `to`, or else the one with the same id, or of the same driver with the
/// same name. \throws config::Error that names the instances and channels that are not there.
PlayResult play_into(System& system, recording::RecordingReader& recording, const PlayOptions& options,
                     const std::stop_token& stop);

/// Plays to a topology in this process, with embedded broker and registry: an instance for each recorded one, of the
/// same driver, with the same channels and metadata. When the last message is processed it stops the topology.
/// \param news gets a line now and then. \throws config::ConfigError, config::Error.
PlayResult play_to_topology(const std::string& yaml_file, const std::vector<std::string>& library_folders,
                            recording::RecordingReader& recording, const PlayOptions& options,
                            const std::function<void(const std::string&)>& news, const std::stop_token& stop);

}  // namespace iotcloud::recorder
