#pragma once

#include <string>
#include <vector>

#include <netdb.h>
#include <sys/socket.h>

#include <iotcloud/processes/places.h>

namespace iotcloud::processes {

/// What a confined process may connect to.
struct Network {
  std::vector<Place> places;
  std::string remedy;  ///< for people: where a place that is missing is to be named
};

/// Starts a process, the connector, that makes connections for this one and ends with it. This one may then give up the
/// right to connect (filter_connections()) and still have its sockets connected to these places, by connect_through().
/// The connector alone asks for machines' names, of those places only. It outlives nobody and is no child of this
/// process. Call it while the process has one thread; a second call replaces the places. \throws config::Error
void start_connector(const Network& network);

/// Whether start_connector() was called.
bool has_connector() noexcept;

/// As connect() of the C library, by way of the connector, which gets the socket and a copy of the address: EACCES if
/// it is none of the places, which the log names. Thread safe. If the connector is gone this process ends, so that both
/// are started again.
int connect_through(int socket, const sockaddr* address, socklen_t size) noexcept;

/// As getaddrinfo() of the C library, which `real` is: the connector finds out the addresses of a machine that a place
/// names. All others are left to `real`, which in a confined process knows those of /etc/hosts. The result is one for
/// freeaddrinfo(). Thread safe.
int find_through(decltype(&getaddrinfo) real, const char* node, const char* service, const addrinfo* hints,
                 addrinfo** found) noexcept;

}  // namespace iotcloud::processes
