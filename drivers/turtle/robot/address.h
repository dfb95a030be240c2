#pragma once

#include <string>
#include <utility>

namespace iotcloud::drivers::turtle::robot {

/// A socket that listens at "ADDRESS:PORT": a number ("127.0.0.1:7411", "[::1]:7411", "0.0.0.0:7411"), or localhost;
/// port 0 is any that is free. It never blocks. \throws std::invalid_argument for what is no such address;
/// std::runtime_error when nobody can listen there.
int listen_at(const std::string& address);

/// Whether "HOST:PORT" is on this machine and nowhere else; of names only localhost is. \throws std::invalid_argument
/// for what is no such address.
bool is_loopback(const std::string& address);

/// Where a socket listens, as "ADDRESS:PORT".
std::string address_of(int socket);

/// "HOST:PORT" in two. \throws std::invalid_argument when it is none.
std::pair<std::string, std::string> split_address(const std::string& address);

/// That an address which others can reach has a token of at least 16 characters. \throws std::invalid_argument
/// otherwise, which names the property and says what to do.
void check_token(const std::string& address, const std::string& token, const std::string& property);

}  // namespace iotcloud::drivers::turtle::robot
