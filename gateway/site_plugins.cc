#include "iotcloud/gateway/gateway_types.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/site_plugins.h>

namespace iotcloud::gateway {

/// Runs a method on the store, and turns its errors into wire::TSiteError.
template <typename Method>
void SitePlugins::with_store(Method&& method) {
  try {
    if (store_ == nullptr) throw config::Error("this gateway takes no plugins that are sent");
    method(*store_);
  } catch (const config::Error& e) {
    logger.warn("a plugin was not taken: {}", e.what());
    config::process_metrics()
        .counter("iotcloud_gateway_plugins_refused_total",
                 "Plugins that somebody wanted to send and that were not taken")
        .add();
    wire::TSiteError error;
    error.__set_reason(e.what());
    throw error;
  }
}

std::string SitePlugins::offer(const processes::PluginStore::Offer& offer) {
  std::string upload;
  with_store([&](processes::PluginStore& store) { upload = store.offer(offer); });
  return upload;
}

void SitePlugins::add(const std::string& upload, std::int64_t offset, std::string_view bytes) {
  with_store([&](processes::PluginStore& store) { store.add(upload, offset, bytes); });
}

void SitePlugins::finish(const std::string& upload) {
  with_store([&](processes::PluginStore& store) { store.finish(upload); });
}

}  // namespace iotcloud::gateway
