#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <tuple>
#include <utility>

#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/plugins/plugin_store.h>
#include <iotcloud/gateway/plugins/plugin_trust.h>

namespace iotcloud::gateway {

/// Finds the plugins that orders name, in the gateway's plugin folder or among those that were sent to it, and checks
/// them before a host opens them. Thread safe.
class PluginSource {
 public:
  /// \param folder of the gateway's own plugins, each with its signature beside it in FILE.sig.
  /// \param store of those that were sent; null: there are none. \param trust null: no signature is asked for.
  PluginSource(std::string folder, std::shared_ptr<PluginStore> store, std::shared_ptr<const PluginTrust> trust);

  struct Found {
    std::string path;
    PluginIdentity identity;
    /// The host must use exactly the bytes with this SHA-256 (they were checked), whatever the file has by then.
    bool exactly = false;
    bool isolated = false;  ///< it asks for a host for each instance (IOTCLOUD_DRIVER_ISOLATED)
  };
  /// \throws config::Error when it is not there, is not what the order names, or is not signed as it must be.
  Found find(const HostOrder& order);

 private:
  /// What a file has been, until it changes: reading and checking it takes a tenth of a second.
  using Stamp = std::tuple<std::uint64_t, std::uint64_t, std::int64_t, std::int64_t, std::int64_t>;
  static Stamp stamp_of(const std::string& path);
  struct Examined {
    PluginIdentity identity;
    bool isolated = false;
  };
  Examined examine(const std::string& path, const std::string& signature_path, const HostOrder& order);

  const std::string folder_;
  const std::shared_ptr<PluginStore> store_;
  const std::shared_ptr<const PluginTrust> trust_;
  std::mutex mutex_;
  /// What the outcome depends on: the plugin's file, its signature's, and the generation of trust.
  using Basis = std::tuple<Stamp, Stamp, std::uint64_t>;
  std::map<std::string, std::pair<Basis, Examined>> examined_;  ///< by path; guarded by mutex_
};

}  // namespace iotcloud::gateway
