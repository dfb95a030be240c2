#include <utility>

#include <thrift/TProcessor.h>

#include <iotcloud/config/error.h>
#include <iotcloud/rpc/guarded_service.h>

namespace iotcloud::rpc {

GuardedService::GuardedService(Options options, Serve serve) {
  const ListenSettings& listen = options.listen;
  if (const auto problem = exposure(listen); !problem.empty()) throw config::Error(problem);
  access_.service = options.limits.name;
  access_.rules = std::move(options.rules);
  access_.users = listen.users;
  access_.open = listen.open;
  access_.limits = std::make_shared<RoleLimits>(listen.calls);
  access_.audit = std::move(options.audit);
  if (!listen.tokens.empty()) access_.tokens = std::make_shared<security::TokenKeeper>(listen.tokens, "thrift");
  ThriftServerOptions serving = std::move(options.limits);
  serving.host = listen.host;
  serving.port = listen.port;
  serving.tls = listen.tls;
  server_.emplace(serving, [this, serve = std::move(serve)](const std::shared_ptr<ThriftPeer>& peer) {
    auto session = std::make_shared<CallerSession>(access_, peer);
    return guarded(serve(session), session);
  });
}

void GuardedService::reload() {
  // The audit log comes first, so that an unreadable file below does not keep a log open that somebody has renamed.
  if (access_.audit) access_.audit->reopen();
  if (access_.tokens) access_.tokens->reload();
  server_->reload();  // after the tokens: it closes connections whose token is gone
}

}  // namespace iotcloud::rpc
