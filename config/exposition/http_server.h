#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>

namespace iotcloud::config {

struct HttpRequest {
  std::string path;                          ///< "/metrics"
  std::map<std::string, std::string> query;  ///< decoded
};

struct HttpAnswer {
  int status = 200;
  std::string content_type = "application/json";
  std::string body;
};

/// Answers one GET. Called on the server's thread, one call at a time: keep it short. What it throws is answered as
/// 500.
using HttpHandler = std::function<HttpAnswer(const HttpRequest&)>;

/// A small HTTP/1.1 server for a daemon's own pages, from construction to destruction: GET and HEAD, one thread, at
/// most 64 connections. No TLS: who may reach it is up to the address. Linked by daemons only. Thread safe.
class HttpServer {
 public:
  /// \param address "host:port", for example "127.0.0.1:9100"; port 0: one that is free.
  /// \param pages the handler of each path; they outlive the server's use of them.
  /// \throws Error when the address cannot be read or bound.
  HttpServer(const std::string& address, std::map<std::string, HttpHandler> pages);
  /// Returns when no handler runs any more.
  ~HttpServer();

  std::string address() const;  ///< "host:port" with the real port

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Whether "host:port" can be reached from this machine only.
bool is_loopback_address(const std::string& address);

}  // namespace iotcloud::config
