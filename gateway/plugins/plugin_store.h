#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <string_view>

#include <iotcloud/config/clock.h>
#include <iotcloud/gateway/plugins/plugin_trust.h>

namespace iotcloud::gateway {

/// The plugins that were sent to a gateway, each kept by the SHA-256 of its bytes: <folder>/<sha256>/plugin.so and,
/// when it is signed, <folder>/<sha256>/signature. What stands there is whole at any time, after a loss of power too:
/// it is written beside, brought to the disk, checked, and only then given its name. Thread safe.
class PluginStore {
 public:
  struct Options {
    std::string folder;  ///< made when it is missing; only its owner may write there
    std::int64_t most_bytes = std::int64_t{64} << 20;
    int most_uploads = 4;                              ///< at once
    std::chrono::milliseconds idle_limit{60'000};      ///< an upload that nobody goes on with ends
    std::chrono::milliseconds unnamed_limit{600'000};  ///< a plugin that no order names goes
    std::shared_ptr<const PluginTrust> trust;          ///< null: nobody is trusted, no signature is asked for
    const config::Clock* clock = nullptr;              ///< nullptr: the system's
    std::function<std::string()> new_upload_id;        ///< empty: ids that nobody guesses
  };
  /// Clears away what an earlier life left half written. \throws config::Error when the folder cannot be used.
  explicit PluginStore(Options options);
  ~PluginStore();

  struct Offer {
    std::string file;       ///< plain file name, for messages
    std::string sha256;     ///< of all bytes
    std::int64_t size = 0;  ///< bytes
    std::string signature;  ///< empty: not signed
  };
  /// Begins an upload. \return its id; empty: the plugin is here already (and will be for `unnamed_limit` at least).
  /// \throws config::Error: a name, hash or size that cannot be, too large, too many uploads, no signature where one is
  /// required, no room.
  std::string offer(const Offer& offer);
  /// The next bytes. An error ends the upload. \throws config::Error: no such upload (any more), bytes that are not the
  /// next ones or are more than were offered, a full disk.
  void add(const std::string& upload, std::int64_t offset, std::string_view bytes);
  /// The end: the plugin is kept, on the disk. Ends the upload in any case.
  /// \throws config::Error: bytes are missing or are not those that were offered; a signature that is wrong, where one
  /// is required.
  void finish(const std::string& upload);

  /// Where a kept plugin is. The caller checks the bytes that it uses. \throws config::Error with what to do when it is
  /// not here. \param file for the message.
  std::string path_of(const std::string& sha256, const std::string& file) const;
  /// Where its signature is, or would be.
  std::string signature_path_of(const std::string& sha256) const;

  /// Removes what no order names for `unnamed_limit`, and uploads that nobody goes on with. Call it now and then.
  /// \param named all contents that orders name.
  void clean(const std::set<std::string>& named);
  /// How many uploads are under way.
  int uploads() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
