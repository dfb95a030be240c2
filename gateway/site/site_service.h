#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/config/access/session.h>
#include <iotcloud/config/thrift/listen_settings.h>
#include <iotcloud/gateway/gateway.h>

namespace iotcloud::gateway {

/// The gateway's Thrift service (gateway.thrift): translates calls into orders in the registry and answers when their
/// outcome is known.
class SiteService {
 public:
  struct Options {
    /// Port 0: any free one, see port().
    config::ListenSettings listen{"127.0.0.1", 12905, {}, "", ""};
    std::chrono::milliseconds outcome_limit{15000};  ///< how long a call waits for what comes of its order
    int max_connections = 64;
    int max_message_bytes = 1 << 20;
    int max_items = 10000;   ///< in one list or map
    std::string log_folder;  ///< where driver hosts log; empty: nowhere that could be read
  };

  /// What each method asks of who calls it. A new method states it there, or answers nobody.
  static const config::MethodRules& rules();

  /// Serves when constructed. The gateway and the registry outlive it. \throws config::Error when it cannot listen, or
  /// when others than this machine could give orders without TLS and tokens.
  SiteService(Options options, Gateway& gateway, discovery::Registry& registry, discovery::Paths paths);
  /// Takes no more calls and waits for those under way.
  ~SiteService();
  int port() const;
  /// Reads the certificates and the token file again. \throws config::Error, and then nothing changes.
  void reload();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
