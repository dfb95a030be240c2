// The methods of the service by which plugins are sent.
#include <iotcloud/config/log.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/plugins/plugin_store.h>
#include <iotcloud/gateway/site/site_handler.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log{"gateway.plugins"};

/// Runs a method on the gateway's store; what goes wrong is told in the service's way.
template <typename Method>
void with_store(const Gateway& gateway, Method&& method) {
  try {
    PluginStore* const store = gateway.plugins();
    if (store == nullptr) throw config::Error("this gateway takes no plugins that are sent");
    method(*store);
  } catch (const config::Error& e) {
    log.warn("a plugin was not taken: {}", e.what());
    config::process_metrics()
        .counter("iotcloud_gateway_plugins_refused_total",
                 "Plugins that somebody wanted to send and that were not taken")
        .add();
    wire::TSiteError error;
    error.__set_reason(e.what());
    throw error;
  }
}

}  // namespace

void SiteHandler::offerPlugin(std::string& upload, const wire::TPluginOffer& offer) {
  with_store(gateway_, [&](PluginStore& store) {
    upload = store.offer({offer.plugin, offer.sha256, offer.size, offer.signature});
  });
}

void SiteHandler::sendPlugin(const std::string& upload, std::int64_t offset, const std::string& bytes) {
  with_store(gateway_, [&](PluginStore& store) { store.add(upload, offset, bytes); });
}

void SiteHandler::finishPlugin(const std::string& upload) {
  with_store(gateway_, [&](PluginStore& store) { store.finish(upload); });
}

}  // namespace iotcloud::gateway
