#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// A plugin as orders must name it, and which gateways have it.
struct SentPlugin {
  std::string plugin;
  std::string sha256;  ///< empty: nothing was sent, the plugin is in the gateways' plugin folders
  std::vector<discovery::GatewayId> gateways;  ///< for orders; empty when nothing was sent: as on the command line
  std::vector<InstanceOutcome> failures;       ///< one for each gateway that did not take the plugin
};

/// Sends a plugin of this machine, with the signature in FILE.sig beside it when there is one, to gateways that do not
/// have it yet. Does nothing for a plugin in the gateways' folders (is_local_plugin). \param gateways empty: all.
/// \param terminal shows the progress of a large plugin; nullptr: nobody sees it.
/// \throws std::invalid_argument for a file that cannot be sent; Unreachable, RequestFailed.
SentPlugin send_plugin(const std::string& plugin, const std::vector<discovery::GatewayId>& gateways,
                       MasterClient& master, std::ostream* terminal);

/// A component library as submissions must name it, and the pools that have it.
struct SentToPools {
  std::string file;  ///< its plain name
  std::string sha256;
  std::vector<InstanceOutcome> failures;  ///< one for each pool that did not take it
};

/// Sends a component library of this machine, with the signature in FILE.sig beside it when there is one, to all pools
/// that do not have it yet. \param terminal as above. \throws std::invalid_argument for a file that cannot be sent;
/// Unreachable; RequestFailed, also when no pool took it.
SentToPools send_library(const std::string& path, MasterClient& master, std::ostream* terminal);

}  // namespace iotcloud::master::cli
