#pragma once

#include <stdexcept>
#include <string>

namespace iotcloud::rpc {

/// A page could not be read: nobody answers, or the answer is not 200. what() names the address.
struct HttpError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// GETs a page of a daemon on this machine: at most 64 MiB, at most 5 s for each step. Blocks. Thread safe.
/// \param address "127.0.0.1:9100": a number, because no name is looked up. \param target path and query. \return the
/// body.
/// \throws HttpError, also if the address is not on loopback.
std::string http_get(const std::string& address, const std::string& target);

/// Percent-encodes every character that RFC 3986 does not call unreserved, for a value of a query.
std::string encode_query(const std::string& text);

}  // namespace iotcloud::rpc
