#pragma once

#include <iosfwd>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/property_check.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// The declarations of the plugins in gateways' folders. It asks a master when one is first needed. Used by one thread.
class PluginDeclarations {
 public:
  explicit PluginDeclarations(MasterClient& master) : master_(master) {}

  /// The declarations of the plugin of this name on gateways. A gateway that is lost, of the original system, or does
  /// not have the plugin says nothing. \param gateways empty: all
  std::vector<DeclaredPlugin> of(const std::string& plugin, const std::vector<discovery::GatewayId>& gateways);
  /// The declarations of a plugin that was sent, as the gateways that keep it say.
  std::vector<DeclaredPlugin> sent(const std::string& sha256);
  /// The gateways that live and could not be asked, each with the reason.
  const std::map<discovery::GatewayId, std::string>& silent() const { return silent_; }

 private:
  void ask();

  MasterClient& master_;
  std::optional<std::vector<GatewayPlugin>> known_;
  std::map<discovery::GatewayId, std::string> silent_;
};

/// Says which gateways could not be asked, so that properties for them were not checked.
void tell_unchecked(const PluginDeclarations& declarations, std::ostream& err);

/// What is wrong with properties, as one text with a line for each problem; empty: nothing.
std::string lines_of(const std::vector<config::PropertyProblem>& problems);

}  // namespace iotcloud::master::cli
