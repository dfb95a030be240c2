#pragma once

#include <string>
#include <utility>

namespace iotcloud::drivers::turtle::robot {

/// Opens a non-blocking socket that listens at "ADDRESS:PORT". ADDRESS is a number ("127.0.0.1:7411", "[::1]:7411",
/// "0.0.0.0:7411") or localhost; port 0 takes any free port. \throws std::invalid_argument for other texts;
/// std::runtime_error if it cannot listen there.
int listen_at(const std::string& address);

/// Whether "HOST:PORT" can only be reached from this machine; localhost is the only name for which this is true.
/// \throws std::invalid_argument for other texts.
bool is_loopback(const std::string& address);

/// A listening socket's address as "ADDRESS:PORT".
std::string address_of(int socket);

/// Splits "HOST:PORT" into its parts. \throws std::invalid_argument for other texts.
std::pair<std::string, std::string> split_address(const std::string& address);

/// Checks that an address which other machines can reach has a token of at least 16 characters. Otherwise \throws
/// std::invalid_argument that names the property and says what to do.
void check_token(const std::string& address, const std::string& token, const std::string& property);

}  // namespace iotcloud::drivers::turtle::robot
