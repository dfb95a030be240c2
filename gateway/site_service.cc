#include <memory>
#include <utility>

#include <iotcloud/gateway/site_handler.h>
#include <iotcloud/gateway/site_service.h>

namespace iotcloud::gateway {

using rpc::RefusalForm;
using security::Role;

const rpc::MethodRules& SiteService::rules() {
  static const rpc::MethodRules rules{
      {"authenticate", {Role::anyone, RefusalForm::response}},
      {"ping", {Role::viewer}},
      {"hearbeat", {Role::viewer}},
      {"getChanges", {Role::viewer, RefusalForm::error}},
      {"readLog", {Role::viewer, RefusalForm::error}},
      {"lookAtChannel", {Role::viewer, RefusalForm::error}},
      {"handMessage", {Role::operating, RefusalForm::error, true, true}},
      {"getCarried", {Role::viewer, RefusalForm::error}},
      {"listPlugins", {Role::viewer, RefusalForm::error}},
      {"startSensor", {Role::operating, RefusalForm::response}},
      {"stopSensor", {Role::operating, RefusalForm::response}},
      {"deploySensor", {Role::admin, RefusalForm::response}},
      {"unDeploySensor", {Role::admin, RefusalForm::response}},
      {"offerPlugin", {Role::admin, RefusalForm::error, true, true}},
      {"sendPlugin", {Role::admin, RefusalForm::error, false, true}},
      {"finishPlugin", {Role::admin, RefusalForm::error, true, true}},
  };
  return rules;
}

namespace {

rpc::GuardedService::Options guarding(const SiteService::Options& options) {
  rpc::GuardedService::Options guarding;
  guarding.rules = SiteService::rules();
  guarding.listen = options.listen;
  guarding.audit = options.audit;
  guarding.limits.name = "gateway";
  guarding.limits.max_connections = options.max_connections;
  guarding.limits.max_message_bytes = options.max_message_bytes;
  guarding.limits.max_items = options.max_items;
  return guarding;
}

}  // namespace

SiteService::SiteService(const Options& options, Gateway& gateway, discovery::Registry& registry,
                         const discovery::Paths& paths)
    : service_(guarding(options), [&gateway, &registry, paths, options](auto session) {
        auto handler = std::make_shared<SiteHandler>(options, gateway, registry, paths, session);
        return std::make_shared<wire::TSensorSiteServiceProcessor>(std::move(handler));
      }) {}

}  // namespace iotcloud::gateway
