#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>

#include <sys/types.h>

#include <iotcloud/rpc/http/http_server.h>

/// A site: it takes requests of any method with small bodies, answers from any thread, and may send one answer piece by
/// piece for hours, such as Server-Sent Events.
namespace iotcloud::rpc {

/// A request to a site.
struct SiteRequest : HttpRequest {
  std::string method;                          ///< "GET"; a HEAD is a GET whose body the server leaves out
  std::map<std::string, std::string> headers;  ///< by their names in lower case
  std::string body;                            ///< at most 64 KiB
  std::string address;                         ///< "192.0.2.7:40112"
  std::string certificate;                     ///< the subject of the reader's certificate; empty: none
  std::optional<uid_t> user;                   ///< of this machine; nullopt: elsewhere, or not known
};

/// An answer without end. Any thread may send; what is sent after the reader has gone is lost.
class HttpStream {
 public:
  virtual ~HttpStream() = default;
  /// Sends a piece. A reader that is more than 16 MiB behind, or takes nothing for 15 s, is cut off.
  /// \return false: the reader has gone
  virtual bool send(std::shared_ptr<const std::string> piece) = 0;
  /// Ends the answer when all pieces are sent.
  virtual void end() = 0;
};

/// The answer to one request, to be given once, on any thread. One that is never given is a 500.
class HttpReply {
 public:
  virtual ~HttpReply() = default;
  virtual void answer(HttpAnswer answer) = 0;
  /// Begins an answer without end. \param head its status, type and headers; its body is the first piece.
  virtual std::shared_ptr<HttpStream> stream(HttpAnswer head) = 0;
};

}  // namespace iotcloud::rpc
