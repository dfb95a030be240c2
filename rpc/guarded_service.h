#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/rpc/session.h>
#include <iotcloud/rpc/thrift_server.h>

namespace iotcloud::rpc {

/// A daemon's Thrift service: who may call what is said by its rules and by the daemon's file. Thread safe.
class GuardedService {
 public:
  /// Makes the processor of one connection. Called on the connection's thread.
  using Serve = std::function<std::shared_ptr<apache::thrift::TProcessor>(std::shared_ptr<CallerSession> session)>;
  struct Options {
    MethodRules rules;
    ListenSettings listen;                      ///< port 0: any free port, see port()
    std::shared_ptr<security::AuditLog> audit;  ///< null: orders are in the ordinary log only
    ThriftServerOptions limits;                 ///< with the service's name; the rest of where it listens is ignored
  };

  /// Serves from construction on. \throws config::Error if it cannot listen, or if other machines could give orders
  /// without TLS and tokens.
  GuardedService(Options options, Serve serve);
  /// Takes no new calls and waits for the running ones.
  ~GuardedService() = default;
  GuardedService(const GuardedService&) = delete;
  GuardedService& operator=(const GuardedService&) = delete;

  int port() const { return server_->port(); }
  /// Opens the audit log by its name again, then reads the token file and the certificates again. \throws config::Error
  /// that names the first unusable file; that file and those after it stay as they were.
  void reload();

 private:
  AccessOptions access_;
  std::optional<ThriftServer> server_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::rpc
