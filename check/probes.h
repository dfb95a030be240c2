#pragma once

#include <chrono>

#include <iotcloud/check/machine.h>

namespace iotcloud::check {

// Each looks at one thing, and adds what it found. None changes anything, but for a port or a connection that it opens
// and closes, and a queue at RabbitMQ.

/// Whether this machine's clock is kept by a time server.
void check_clock(Findings& findings);
/// Whether the ports can be opened, or a daemon of ours has opened them.
void check_ports(const Machine& machine, Findings& findings);
/// Room in the folders, and whether they may be written.
void check_disk(const Machine& machine, Findings& findings);
/// Certificates and keys: readable, of each other, and how long they are worth something. \param now_s Unix time
void check_certificates(const Machine& machine, std::int64_t now_s, Findings& findings);
/// The SDKs that the plugins in the folder were built with.
void check_plugins(const Machine& machine, Findings& findings);
/// Whether the registry answers within the limit, and lets this user read.
void check_registry(const Machine& machine, std::chrono::milliseconds limit, Findings& findings);
/// Whether each broker takes a connection within the limit. At RabbitMQ it makes a queue, which is gone a minute later.
void check_brokers(const Machine& machine, std::chrono::milliseconds limit, Findings& findings);

/// All of these.
void check_all(const Machine& machine, std::chrono::milliseconds limit, Findings& findings);

}  // namespace iotcloud::check
