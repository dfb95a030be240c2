#pragma once

#include <string>

#include <iotcloud/discovery/records.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::master {

class Master;

/// The credentials with which a master reads workers' pages.
struct WorkerAccess {
  security::TlsFiles tls;  ///< empty: this master reads no worker's pages
  std::string token_file;  ///< its first line is the token; empty: this master reads no worker's pages
};

/// A page of a topology's worker, which is read at the address of the worker's record, by TLS: the certificate there
/// has the name of that address. Without TLS only a worker of this machine is read, and no token is shown. At most 8
/// MiB, at most 5 s for each step. Blocks. Thread safe. \param worker its name. \param target "/topology" or "/tap?"
/// and an encoded query; no other page is read. \throws config::Error when it cannot be read, with the reason.
std::string read_worker_page(const Master& master, const WorkerAccess& access, const discovery::TopologyName& topology,
                             const std::string& worker, const std::string& target);

}  // namespace iotcloud::master
