#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

/// The reason for which a host fails an instance that publishes on a channel that it has not declared; also that of
/// hosts in tests. \param declared the instance's channels. \return empty: there is such a channel.
std::string unknown_channel(std::string_view channel, Direction direction, const std::vector<ChannelSpec>& declared);

}  // namespace iotcloud::drivers
