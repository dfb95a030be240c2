#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/rpc/http/page_settings.h>

namespace iotcloud::rpc {

/// A GET, without its headers.
struct HttpRequest {
  std::string path;                          ///< "/metrics"
  std::map<std::string, std::string> query;  ///< decoded
};

/// Reads path and query: "/tap?id=a%20b".
HttpRequest read_target(const std::string& target);

/// The response.
struct HttpAnswer {
  int status = 200;
  std::string content_type = "application/json";
  std::string body;
  std::vector<std::pair<std::string, std::string>> headers{};  ///< more headers: name, value
};

/// Answers one GET. The server's thread makes one call at a time, so keep it short. An exception is answered as 500.
using HttpHandler = std::function<HttpAnswer(const HttpRequest&)>;

struct SiteRequest;
class HttpReply;
/// Answers one request of a site, at once or later (http_site.h). Called on the server's thread: it must not block.
using HttpSite = std::function<void(SiteRequest request, std::shared_ptr<HttpReply> reply)>;

/// A small HTTP/1.1 server for a daemon's own pages, from construction to destruction: GET and HEAD, one thread, at
/// most 64 connections. One more makes the server cut off, of the reader who has the most, the connection that has been
/// the longest at sending its request or taking its answer; so neither slow clients nor many keep others away. A reader
/// is who has a certificate, a user of this machine, or a host. One has a quarter of the thread's time while others
/// ask, and gets 429 where its turn would come too late. Counted: iotcloud_http_refused_total{reason}. An address that
/// other machines can reach has TLS 1.2+ and takes a token ("Authorization: Bearer TOKEN"; 401 without), see
/// page_settings.h. Only daemons link it. Thread safe.
class HttpServer {
 public:
  /// \param settings with an address "host:port", for example "127.0.0.1:9100"; port 0: any free port.
  /// \param pages the handler of each path, kept until the destructor ends.
  /// \throws Error when the address cannot be read or bound, or may not be served with these settings.
  /// \param clock by which token files are looked at, and tries of tokens and the time for each reader are counted.
  /// Outlives the server.
  HttpServer(const PageSettings& settings, std::map<std::string, HttpHandler> pages,
             const config::Clock& clock = config::system_clock());
  /// The same without TLS and tokens.
  HttpServer(const std::string& address, std::map<std::string, HttpHandler> pages)
      : HttpServer(PageSettings{address, {}, ""}, std::move(pages)) {}
  /// Serves a site (http_site.h) instead of pages, with at most 256 connections. `settings.tokens` only says that the
  /// site asks for tokens; the server does not. Readers need no certificate.
  HttpServer(const PageSettings& settings, HttpSite site);
  /// Returns when no handler runs any more.
  ~HttpServer();

  std::string address() const;  ///< "host:port" with the real port
  /// Reads certificates again, then tokens: open connections are cut whose certificate counts no longer, and not served
  /// without their token. The server does so for certificates by itself within PageSettings::look_period.
  /// \throws Error that names an unusable file; that file and later ones count as they were read before.
  void reload();

 private:
  void serve(const PageSettings& settings, std::map<std::string, HttpHandler> pages, HttpSite site,
             const config::Clock& clock);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::rpc
