#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/lan/lan_finder.h>

namespace iotcloud::drivers::lan {

/// Reads an answer of WS-Discovery from the address `from`, a stranger's, and calls `found` for each device in it.
/// \param asked ids of questions; an answer to another one is passed over
/// \return why it is passed over, or the rest of it; empty: it is not
std::string read_onvif_answer(std::string_view answer, const std::string& from, const std::vector<std::string>& asked,
                              const OnFound& found);

/// Finds cameras and other devices of ONVIF by WS-Discovery: README.md.
class OnvifFinder final : public LanFinder {
 public:
  static constexpr std::string_view description = "Finds cameras and other devices of ONVIF, by WS-Discovery";
  static constexpr std::array declared_properties = shared_properties;
  OnvifFinder() : LanFinder("239.255.255.250:3702") {}

 private:
  std::vector<std::string> questions() override;
  std::string answered(std::string_view answer, const std::string& from) override {
    return read_onvif_answer(answer, from, {asked_, asked_before_},
                             [this](const auto& key, const auto& attributes) { found(key, attributes); });
  }

  std::string asked_, asked_before_;  ///< ids of the last two questions
};

}  // namespace iotcloud::drivers::lan
