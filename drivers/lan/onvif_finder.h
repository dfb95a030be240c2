#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/lan/lan_finder.h>

namespace iotcloud::drivers::lan {

/// Finds cameras and other devices of ONVIF by WS-Discovery: README.md.
class OnvifFinder final : public LanFinder {
 public:
  static constexpr std::string_view description = "Finds cameras and other devices of ONVIF, by WS-Discovery";
  static constexpr std::array declared_properties = shared_properties;
  OnvifFinder() : LanFinder("239.255.255.250:3702") {}

 private:
  std::vector<std::string> questions() override;
  std::string answered(std::string_view answer, const std::string& from) override;

  std::string asked_, asked_before_;  ///< ids of the last two questions
};

}  // namespace iotcloud::drivers::lan
