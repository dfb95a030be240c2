#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <iotcloud/config/file_stamp.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/fleet/launcher.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::gateway {

/// Finds the plugins that orders name, in the gateway's plugin folder or among the uploaded ones, and checks them
/// before a host loads them. Thread safe.
class PluginSource {
 public:
  /// \param folder of the gateway's own plugins, each with its signature beside it in FILE.sig.
  /// \param store the uploaded plugins; null: there are none. \param trust null: no signature is required.
  /// \param trust_folder the folder's own plugins need no signature.
  PluginSource(std::string folder, std::shared_ptr<processes::PluginStore> store,
               std::shared_ptr<const security::TrustedKeys> trust, bool trust_folder = false);

  /// A plugin that was found and checked.
  struct Found {
    std::string path;
    PluginIdentity identity;
    security::PluginSignature signature;  ///< only if identity.signed_by is not empty
    /// The host must load the bytes with the checked SHA-256, and refuse the file if it has changed since.
    bool exactly = false;
    bool isolated = false;  ///< the plugin requires a separate host for each instance (IOTCLOUD_DRIVER_ISOLATED)
  };
  /// \throws config::Error if the plugin is missing, is not the one that the order names, or lacks a required
  /// signature.
  Found find(const HostOrder& order);
  /// PluginIdentity::driver of the plugin that the order names, whatever its signature; empty: it is not there.
  discovery::DriverName driver_of(const HostOrder& order);
  /// All plugins of the folder, and all that were sent. They are read, not loaded. \param names as in
  /// HostLauncher::plugins()
  std::vector<discovery::KnownPlugin> all(const std::map<std::string, std::string>& names);

 private:
  struct Examined {
    PluginIdentity identity;
    security::PluginSignature signature;
    bool isolated = false;
    std::int64_t size = 0;
    std::string declaration;  ///< JSON of config/declaration.h
  };
  discovery::KnownPlugin known(const std::string& path, const std::string& signature_path, const HostOrder& order);
  Examined examine(const std::string& path, const std::string& signature_path, const HostOrder& order);

  const std::string folder_;
  const std::shared_ptr<processes::PluginStore> store_;
  const std::shared_ptr<const security::TrustedKeys> trust_;
  const bool trust_folder_;
  config::Mutex mutex_;
  /// The inputs of examine(), by which its result is cached: the stamps of the plugin's file and of its signature's
  /// file, and TrustedKeys::generation().
  using Basis = std::tuple<config::FileStamp, config::FileStamp, std::uint64_t>;
  std::map<std::string, std::pair<Basis, Examined>> examined_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by path
  using Version = std::pair<std::string, std::string>;  ///< HostOrder::plugin and sha256
  /// The results of driver_of(), each with the stamp of the file that was read.
  std::map<Version, std::pair<config::FileStamp, discovery::DriverName>> drivers_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
