#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// A plugin as orders name it, and which gateways have it.
struct SentPlugin {
  std::string plugin;
  std::string sha256;                            ///< empty: of the gateways' plugin folders, nothing was sent
  std::vector<std::string> gateways;             ///< that orders may go to; empty when nothing was sent: as commanded
  std::vector<wire::TInstanceOutcome> failures;  ///< of gateways that did not take it
};

/// Sends a plugin of this machine, with the signature in FILE.sig beside it when there is one, to gateways that do not
/// have it yet. Nothing is done for one that stands in the gateways' folders (is_local_plugin). \param gateways empty:
/// all. \param terminal shows how far a large one is; nullptr: that is not shown.
/// \throws std::invalid_argument for a file that cannot be sent; Unreachable, Failed.
SentPlugin send_plugin(const std::string& plugin, const std::vector<std::string>& gateways, MasterClient& master,
                       std::ostream* terminal);

}  // namespace iotcloud::master::cli
