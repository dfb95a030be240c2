#include <memory>
#include <optional>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/site_handler.h>
#include <iotcloud/gateway/site_service.h>
#include <iotcloud/rpc/thrift_server.h>

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

struct SiteService::Impl {
  Impl(const Options& options, Gateway& g, discovery::Registry& r, discovery::Paths p)
      : outcome_limit(options.outcome_limit),
        log_folder(options.log_folder),
        gateway(g),
        registry(r),
        paths(std::move(p)) {
    access.service = "gateway";
    access.rules = rules();
    access.users = options.listen.users;
    access.open = options.listen.open;
    access.limits = std::make_shared<rpc::RoleLimits>(options.listen.calls);
    access.audit = options.audit;
    if (!options.listen.tokens.empty())
      access.tokens = std::make_shared<security::TokenKeeper>(options.listen.tokens, "thrift");
  }

  std::shared_ptr<apache::thrift::TProcessor> serve(const std::shared_ptr<rpc::ThriftPeer>& peer) {
    auto session = std::make_shared<rpc::CallerSession>(access, peer);
    auto handler = std::make_shared<SiteHandler>(outcome_limit, log_folder, gateway, registry, paths, session);
    return rpc::guarded(std::make_shared<wire::TSensorSiteServiceProcessor>(std::move(handler)), session);
  }

  const std::chrono::milliseconds outcome_limit;
  const std::string log_folder;
  Gateway& gateway;
  discovery::Registry& registry;
  const discovery::Paths paths;
  rpc::AccessOptions access;
  std::optional<rpc::ThriftServer> server;  ///< last, because it uses the other members
};

SiteService::SiteService(const Options& options, Gateway& gateway, discovery::Registry& registry,
                         discovery::Paths paths) {
  if (const auto problem = rpc::exposure(options.listen); !problem.empty()) throw config::Error(problem);
  impl_ = std::make_unique<Impl>(options, gateway, registry, std::move(paths));
  rpc::ThriftServerOptions serving;
  serving.name = "gateway";
  serving.host = options.listen.host;
  serving.port = options.listen.port;
  serving.tls = options.listen.tls;
  serving.max_connections = options.max_connections;
  serving.max_message_bytes = options.max_message_bytes;
  serving.max_items = options.max_items;
  impl_->server.emplace(serving, [impl = impl_.get()](const auto& peer) { return impl->serve(peer); });
}

SiteService::~SiteService() = default;

int SiteService::port() const {
  return impl_->server->port();
}

void SiteService::reload() {
  // The audit log comes first, so that an unreadable file below does not keep a log open that somebody has renamed.
  if (impl_->access.audit) impl_->access.audit->reopen();
  if (impl_->access.tokens) impl_->access.tokens->reload();
  impl_->server->reload();  // after the tokens: it closes connections whose token is gone
}

}  // namespace iotcloud::gateway
