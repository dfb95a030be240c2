#pragma once

#include <functional>
#include <memory>
#include <string>

#include <iotcloud/discovery/ids.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/rpc/session.h>
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

  /// Serves from construction on. \throws config::Error if it cannot listen, or if other machines could send libraries
  /// without TLS and tokens.
  explicit PoolService(Options options);
  /// Takes no new calls and waits for the running ones.
  ~PoolService();
  int port() const;
  /// Opens the audit log by its name again, then reads the token file and the certificates again. \throws config::Error
  /// that names the first unusable file; that file and those after it stay as they were.
  void reload();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology
