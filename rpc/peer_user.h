#pragma once

#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

namespace iotcloud::rpc {

/// The user whose process has the other end of a connection over loopback, as the kernel says (sock_diag(7), or
/// /proc/net/tcp where that is not there). nullopt: the other end is not on this machine, or gone, or the kernel does
/// not say. \param descriptor a connected TCP socket
std::optional<uid_t> peer_user(int descriptor);

/// Whether a user of this machine may do everything without a token: root, the user of this process, and the named
/// accounts. Accounts are looked up each time, because those of systemd's DynamicUser come and go.
bool is_trusted_user(uid_t user, const std::vector<std::string>& accounts);

}  // namespace iotcloud::rpc
