#include <algorithm>

#include <iotcloud/drivers/channel_names.h>

namespace iotcloud::drivers {

std::string unknown_channel(std::string_view channel, Direction direction, const std::vector<ChannelSpec>& declared) {
  std::string others;
  for (const ChannelSpec& spec : declared) {
    if (spec.direction != direction) continue;
    if (spec.name == channel) return "";
    others += (others.empty() ? "\"" : ", \"") + spec.name + "\"";
  }
  const std::string kind = direction == Direction::out ? "outgoing" : "incoming";
  return "there is no " + kind + " channel \"" + std::string(channel) + "\"; " +
         (others.empty() ? "channels() declares none" : "channels() declares " + others);
}

}  // namespace iotcloud::drivers
