#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/gateway/gateway.h>

namespace iotcloud::gateway {

/// The gateway's Thrift service (gateway.thrift): translates calls into orders in the registry and answers when their
/// outcome is known.
class SiteService {
 public:
  struct Options {
    std::string host = "127.0.0.1";
    int port = 12905;                                ///< 0: any free one, see port()
    std::chrono::milliseconds outcome_limit{15000};  ///< how long a call waits for what comes of its order
    int max_connections = 64;
    int max_message_bytes = 1 << 20;
    int max_items = 10000;   ///< in one list or map
    std::string log_folder;  ///< where driver hosts log; empty: nowhere that could be read
  };

  /// \throws config::Error for an address that others than this machine can reach: until connections can be encrypted
  /// and opened with a token, only loopback is allowed.
  static void check_address(const std::string& host);

  /// Serves when constructed. The gateway and the registry outlive it. \throws config::Error when it cannot listen.
  SiteService(Options options, Gateway& gateway, discovery::Registry& registry, discovery::Paths paths);
  /// Takes no more calls and waits for those under way.
  ~SiteService();
  int port() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
