#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <sys/types.h>

#include <iotcloud/processes/descriptor.h>

namespace iotcloud::processes {

/// A Unix domain socket with a name in a folder, whose path may have any length (the address uses the folder's
/// descriptor), on which nobody listens yet. \throws config::Error when it cannot be made.
OwnedDescriptor bind_in(const std::string& folder, const std::string& name);
/// Listens on such a socket. For clients that connect from then on, peer_process() is this process, whichever process
/// made the socket. \throws config::Error when it cannot.
void listen_on(const OwnedDescriptor& socket);
/// Listens on a Unix domain socket in a folder, whose path may have any length (the address uses the folder's
/// descriptor).
/// \throws config::Error when it cannot listen.
OwnedDescriptor listen_in(const std::string& folder, const std::string& name);
/// Connects to such a socket. \return an empty descriptor if it cannot; errno says why.
OwnedDescriptor connect_in(const std::string& folder, const std::string& name);
/// Accepts the next connection; an empty descriptor if none waits.
OwnedDescriptor accept_from(const OwnedDescriptor& listener);
/// The id of the process at the other end of a connected socket; 0 if unknown.
int peer_process(const OwnedDescriptor& socket);
/// Whether the process at the other end of a connected socket has the user who made `listener`, or is root.
bool peer_may_connect(const OwnedDescriptor& socket, const OwnedDescriptor& listener);

/// Sends all bytes; waits at most two seconds for room in the socket. \return false if the peer is gone or does not
/// read.
bool send_all(const OwnedDescriptor& socket, const std::string& bytes);
/// Reads the bytes that have arrived, at most 64 KB. \return nullopt at the end of the stream or on an error; empty if
/// there is nothing.
std::optional<std::string> receive_some(const OwnedDescriptor& socket);

/// Sends bytes, at least one, with descriptors of this process, at most most_passed. \return how many bytes went;
/// negative: none, and errno says why.
ssize_t send_with(const OwnedDescriptor& socket, std::string_view bytes, const std::vector<int>& descriptors);
/// How many descriptors can come with bytes.
inline constexpr std::size_t most_passed = 2;
/// Bytes that came with descriptors.
struct Passed {
  std::string bytes;  ///< empty: at the end of the stream
  std::vector<OwnedDescriptor> descriptors;
};
/// Waits for bytes. \param most how many, at most; the rest of a message is lost. \return nullopt on an error.
std::optional<Passed> receive_with(const OwnedDescriptor& socket, std::size_t most);
}  // namespace iotcloud::processes
