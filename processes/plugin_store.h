#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::processes {

/// The plugins that were uploaded to a gateway, each stored under the SHA-256 of its bytes:
/// `<folder>/<sha256>/plugin.so` and, if it is signed, `<folder>/<sha256>/signature`. A file there is always complete,
/// even after a loss of power: it is written elsewhere, synced to the disk, checked, and only then renamed. Thread
/// safe.
class PluginStore {
 public:
  struct Options {
    std::string folder;  ///< made when it is missing; only its owner may write there
    std::int64_t most_bytes = std::int64_t{64} << 20;
    std::string limit_key = "plugins.upload_limit_mb";   ///< where the daemon's file says so
    int most_uploads = 4;                                ///< at the same time
    std::chrono::milliseconds idle_limit{60'000};        ///< an upload without a call for this long ends
    std::chrono::milliseconds unnamed_limit{600'000};    ///< a plugin that no order has named for this long is removed
    std::shared_ptr<const security::TrustedKeys> trust;  ///< null: no signature is required
    const config::Clock* clock = nullptr;                ///< nullptr: the system's
    std::function<std::string()> new_upload_id;          ///< empty: unguessable random ids
    /// Removes the folder of a plugin; must not throw. Empty: the folder is removed with its content. Only an offer of
    /// the same plugin waits for it.
    std::function<void(const std::string& folder)> remove_folder;
  };
  /// Removes unfinished uploads of an earlier run. \throws config::Error if the folder cannot be used.
  explicit PluginStore(Options options);
  ~PluginStore();

  /// A plugin that somebody wants to send.
  struct Offer {
    std::string file;       ///< plain file name, for messages
    std::string sha256;     ///< SHA-256 of the whole plugin
    std::int64_t size = 0;  ///< bytes
    std::string signature;  ///< empty: not signed
  };
  /// Begins an upload. \return the upload's id; empty: the store has the plugin already, and keeps it for at least
  /// `unnamed_limit`.
  /// \throws config::Error: invalid name, hash or size, plugin too large, too many uploads, required signature missing,
  /// disk full.
  std::string offer(const Offer& offer);
  /// Appends the next bytes. An error ends the upload. \throws config::Error: unknown or ended upload, wrong offset,
  /// more bytes than offered, disk full.
  void add(const std::string& upload, std::int64_t offset, std::string_view bytes);
  /// Ends the upload. When it returns without an exception, the plugin is in the store and on the disk.
  /// \throws config::Error: bytes are missing or do not have the offered SHA-256, or a required signature is wrong.
  void finish(const std::string& upload);

  /// The SHA-256 of all stored plugins.
  std::vector<std::string> all() const;
  /// The path of a stored plugin; nullopt: the store does not have it. The caller must check the bytes that it uses.
  std::optional<std::string> path_of(const std::string& sha256) const;
  /// The path of the plugin's signature, which may not exist.
  std::string signature_path_of(const std::string& sha256) const;

  /// Removes plugins that no order has named for `unnamed_limit`, and abandoned uploads. Call it periodically.
  /// \param named the SHA-256 of all plugins that orders name.
  void clean(const std::set<std::string>& named);
  /// The number of uploads in progress.
  int uploads() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Whether the name is a plain file name inside a folder: not empty, no slash, not "." or "..", no control character.
bool is_plain_file_name(const std::string& name);

}  // namespace iotcloud::processes
