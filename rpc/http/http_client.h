#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>

#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

/// A page could not be read: what answers is no HTTP, is too long, or has another status than 200, whose text is in
/// what(); or it could not be asked for. what() names the address.
struct HttpError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Nobody answers there: the connection was refused, broke or took too long, or its certificate is not the right one.
struct HttpUnreachable : HttpError {
  using HttpError::HttpError;
};

/// The credentials with which a client reads pages.
struct HttpReader {
  security::TlsFiles tls;                 ///< empty: no TLS, and only pages of this machine are read
  std::string token;                      ///< empty: none is shown
  std::size_t largest_page = 64U << 20U;  ///< bytes; a larger page is refused
};

/// GETs a page of a daemon, in at most 5 s for each step. Blocks. Thread safe.
/// \param address "127.0.0.1:9100"; without TLS a number of loopback, with TLS also a name, which the server's
/// certificate must have. \param target path and query. \return the body. \throws HttpError, HttpUnreachable
std::string http_get(const std::string& address, const std::string& target, const HttpReader& reader = {});

/// Percent-encodes every character that RFC 3986 does not call unreserved, for a value of a query.
std::string encode_query(const std::string& text);

}  // namespace iotcloud::rpc
