#pragma once

#include <functional>
#include <memory>
#include <string>

#include <iotcloud/discovery/ids.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/rpc/guarded_service.h>
#include <iotcloud/security/audit_log.h>

namespace iotcloud::topology {

/// The pool's Thrift service (pool.thrift): takes component libraries, and shows logs of workers.
class PoolService {
 public:
  struct Options {
    rpc::ListenSettings listen{"127.0.0.1", 0, {}, "", ""};
    security::AuditSettings audit{};  ///< who sent libraries
    discovery::PoolId pool;
    std::string state_folder;                           ///< for logs
    std::shared_ptr<processes::PluginStore> libraries;  ///< not null
    std::function<void()> on_library;                   ///< a library was sent; called on any thread
  };

  /// The role that each method requires of its caller. Nobody may call a method that is not listed.
  static const rpc::MethodRules& rules();

  /// Answers one connection's calls, for servers and tests. \param options outlives it
  static std::shared_ptr<apache::thrift::TProcessor> processor(const Options& options,
                                                               std::shared_ptr<rpc::CallerSession> session);

  /// Serves from construction on. \throws config::Error if it cannot listen, or if other machines could send libraries
  /// without TLS and tokens.
  explicit PoolService(const Options& options);
  int port() const { return service_.port(); }
  /// As rpc::GuardedService::reload().
  void reload() { service_.reload(); }

 private:
  rpc::GuardedService service_;
};

}  // namespace iotcloud::topology
