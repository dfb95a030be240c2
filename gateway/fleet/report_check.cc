#include <algorithm>
#include <sstream>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/fleet/report_check.h>
#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

namespace {

using discovery::ChannelRecord;

std::string property_of(const ChannelRecord& channel, const char* key) {
  const auto found = channel.properties.find(key);
  return found == channel.properties.end() ? std::string() : found->second;
}

std::string wrong_address(const ChannelRecord& channel, const std::vector<brokers::BrokerSetting>& brokers) {
  const auto broker = std::find_if(brokers.begin(), brokers.end(),
                                   [&](const auto& setting) { return setting.name == channel.transport; });
  if (broker == brokers.end()) return fmt::format("the broker \"{}\", which this gateway has not", channel.transport);
  std::vector<std::string> named{channel.broker_url};
  std::istringstream all(property_of(channel, "urls"));
  for (std::string url; all >> url;) named.push_back(url);
  const auto& known = broker->options.urls;
  for (const auto& url : named) {
    if (std::find(known.begin(), known.end(), url) != known.end()) continue;
    return fmt::format("the address {}, which is not among those of the broker \"{}\" in this gateway's configuration",
                       brokers::printable_url(url), channel.transport);
  }
  return "";
}

/// The names of topics need no check: readers make them of these names and the record's own
/// (discovery/channel_names.h).
std::string wrong_names(const ChannelRecord& channel, const InstanceStatus& told, const discovery::GatewayId& gateway) {
  if (channel.gateway != gateway || channel.driver != told.driver || channel.instance != told.instance)
    return fmt::format("as {}'s channel of {} {}", channel.gateway, channel.driver, channel.instance);
  return "";
}

}  // namespace

std::string contradiction(const InstanceStatus& told, const discovery::OrderRecord& order,
                          const discovery::DriverName& driver, const discovery::GatewayId& gateway,
                          const std::vector<brokers::BrokerSetting>& brokers) {
  if (told.instance != order.instance || (!driver.empty() && told.driver != driver))
    return fmt::format("it says that it is {} {}, and its order is for {} {}", told.driver, told.instance,
                       driver.empty() ? told.driver : driver, order.instance);
  try {
    check_name("driver name", told.driver);
    for (const auto& channel : told.channels) check_name("channel name", channel.name);
  } catch (const config::Error& e) {
    return e.what();
  }
  for (const auto& channel : told.channels) {
    std::string wrong = wrong_names(channel, told, gateway);
    if (wrong.empty()) wrong = wrong_address(channel, brokers);
    if (!wrong.empty()) return fmt::format("it names for its channel \"{}\" {}", channel.name, wrong);
  }
  return "";
}

}  // namespace iotcloud::gateway
