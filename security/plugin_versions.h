#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/security/plugin_signature.h>

namespace iotcloud::security {

/// A plugin that must not run here, whatever becomes of the disk or the memory.
struct VersionRefused : config::Error {
  using Error::Error;
};

/// The versions of signed plugins, or component libraries, that ran in this gateway, or pool of workers. A signature
/// does not expire, so a signed version with a security hole stays signed after the next version has closed the hole.
/// Therefore a version that is older than one that ran here does not run again, except when an update goes back, or if
/// the configuration allows it. Only an order of an update opens that way: the newer version of a plain deployment does
/// not. Thread safe.
class PluginVersions {
 public:
  struct Options {
    std::string file;                         ///< where they are kept; made when the first one is known
    std::vector<std::string> allow_rollback;  ///< names of plugins whose older versions may run
    bool require_version = false;             ///< a plugin that was signed without a version does not run
    /// For so long after an update brought a version, the one before it may run again.
    std::chrono::milliseconds way_back{3'600'000};
    std::string keys = "plugins";  ///< whose `allow_rollback` a person sets, for messages
  };
  /// \throws config::Error if the file cannot be read or is damaged.
  explicit PluginVersions(Options options, const config::Clock& clock = config::system_clock());

  /// Takes note that a plugin is about to run. \param plugin its file, such as turtle.so. \param signature one that a
  /// trusted key made. \param of_update the order is one of an update.
  /// \throws VersionRefused if it must not run, with the reason; config::Error if the note cannot be written
  void admit(const std::string& plugin, const PluginSignature& signature, bool of_update) IOTCLOUD_EXCLUDES(mutex_);

 private:
  struct Known {
    std::uint64_t newest = 0, before = 0;
    std::int64_t since_ms = 0;  ///< when an update brought `newest`; wall time; 0: no update did
  };
  using AllKnown = std::map<std::string, Known>;  ///< by the name that the signer gave
  void refuse_without_version(const std::string& plugin) const IOTCLOUD_REQUIRES(mutex_);
  bool may_go_back(const std::string& name) const;
  Known known(const std::string& name) const IOTCLOUD_REQUIRES(mutex_);
  /// Takes note of a version that is newer than all that ran. Releases the mutex while it writes the file.
  void learn(const PluginSignature& signature, bool of_update) IOTCLOUD_REQUIRES(mutex_);
  void write(const AllKnown& known) const IOTCLOUD_EXCLUDES(mutex_);

  const Options options_;
  const config::Clock& clock_;
  config::Mutex mutex_;
  config::ConditionVariable written_;
  AllKnown known_ IOTCLOUD_GUARDED_BY(mutex_);        ///< what the file has
  bool writing_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< a thread writes the file
};

}  // namespace iotcloud::security
