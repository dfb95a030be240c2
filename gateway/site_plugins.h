#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include <iotcloud/processes/plugin_store.h>

namespace iotcloud::gateway {

/// Uploads of plugins over the gateway's Thrift service: PluginStore's methods, with refusals thrown as
/// wire::TSiteError, logged and counted (iotcloud_gateway_plugins_refused_total). Thread safe.
class SitePlugins {
 public:
  /// \param store outlives this object; null: this gateway takes no uploads.
  explicit SitePlugins(processes::PluginStore* store) : store_(store) {}

  /// \return the upload's id; empty: the store has the plugin already.
  std::string offer(const processes::PluginStore::Offer& offer);
  void add(const std::string& upload, std::int64_t offset, std::string_view bytes);
  void finish(const std::string& upload);

 private:
  template <typename Method>
  void with_store(Method&& method);

  processes::PluginStore* const store_;
};

}  // namespace iotcloud::gateway
