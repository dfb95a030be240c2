#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/gateway/gateway.h>
#include <iotcloud/rpc/guarded_service.h>

namespace iotcloud::gateway {

/// The gateway's Thrift service (gateway.thrift): translates calls into orders in the registry and answers when their
/// outcome is known.
class SiteService {
 public:
  struct Options {
    /// Port 0: any free port, see port().
    rpc::ListenSettings listen{"127.0.0.1", 12905, {}, "", ""};
    std::chrono::milliseconds outcome_limit{15000};  ///< how long a call waits for the outcome of its order
    std::chrono::milliseconds answer_limit{2000};    ///< how long a call waits for what a driver host is asked
    int max_connections = 64;
    int max_message_bytes = 1 << 20;
    int max_items = 10000;                        ///< the most items in one list or map
    std::shared_ptr<security::AuditLog> audit{};  ///< who gave orders to this service; null: no audit log
    std::string log_folder;  ///< the folder of the driver hosts' logs; empty: readLog has nothing to read
  };

  /// The role that each method requires of its caller. Nobody may call a method that is not listed.
  static const rpc::MethodRules& rules();

  /// Serves from construction on. The gateway and the registry outlive it. \throws config::Error if it cannot listen,
  /// or if other machines could give orders without TLS and tokens.
  SiteService(const Options& options, Gateway& gateway, discovery::Registry& registry, const discovery::Paths& paths);
  int port() const { return service_.port(); }
  /// As rpc::GuardedService::reload().
  void reload() { service_.reload(); }

 private:
  rpc::GuardedService service_;
};

}  // namespace iotcloud::gateway
