#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

namespace iotcloud::drivers::http {

/// A request that somebody sends to the driver.
struct Webhook {
  std::string method, path, query;  ///< the query without its question mark, not decoded
  std::string content_type, authorization, peer, body;
};

struct WebhookAnswer {
  int status = 204;
  std::string text{};
  int retry_after_s = 0;  ///< 0: does not say
};

struct ServerOptions {
  std::string address;           ///< a number
  std::uint16_t port = 0;        ///< 0: any
  std::string certificate, key;  ///< files; empty: no TLS
  std::size_t most_bytes = 1 << 20;
  std::size_t connections = 64;
};

/// A request of the driver.
struct Call {
  bool tls = false;
  std::string host, port;
  std::string method, target, content_type, authorization, body;
  std::string ca;  ///< file of the authority; empty: the system's
  std::size_t most_bytes = 1 << 20;
  std::chrono::milliseconds limit{10'000};  ///< of each step
};

struct CallAnswer {
  int status = 0;  ///< 0: there was none
  std::string content_type, body;
  std::string problem;  ///< why there was none
};

/// HTTP/1.1 as server and client, on a thread of its own. The only file that includes Boost.Beast is http_end.cc.
class HttpEnd {
 public:
  HttpEnd();
  /// Waits for what runs on the thread, and makes no call of a handler any more.
  ~HttpEnd();
  HttpEnd(const HttpEnd&) = delete;
  HttpEnd& operator=(const HttpEnd&) = delete;

  /// Answers requests by the handler, which is called on this object's thread. Call it once. \return "address:port"
  /// \throws std::runtime_error when it cannot listen there, or cannot use the files
  std::string serve(const ServerOptions& options, std::function<WebhookAnswer(const Webhook&)> handler);
  /// Makes a call, and hands its answer over on this object's thread. \throws std::runtime_error for an unusable
  /// authority
  void call(Call call, std::function<void(CallAnswer)> handler);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::drivers::http
