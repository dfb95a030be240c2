#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/lan/lan_finder.h>

namespace iotcloud::drivers::lan {

/// Reads an answer of mDNS from the address `from`, a stranger's, and calls `found` for each of these services
/// (_http._tcp) that it tells of. \return why it is passed over; empty: it is not
std::string read_mdns_answer(std::string_view answer, const std::string& from, const std::vector<std::string>& services,
                             const OnFound& found);

/// Finds services that machines announce by mDNS and DNS-SD: README.md.
class MdnsFinder final : public LanFinder {
 public:
  static constexpr std::string_view description = "Finds services that machines announce by mDNS and DNS-SD";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "services", .required = true, .text = "such as _http._tcp, _mqtt._tcp, separated by commas"},
      shared_properties[0], shared_properties[1], shared_properties[2]};
  MdnsFinder() : LanFinder("224.0.0.251:5353") {}

 private:
  void read_properties(PropertyReader& reader) override;
  std::vector<std::string> questions() override;
  std::string answered(std::string_view answer, const std::string& from) override {
    return read_mdns_answer(answer, from, services_,
                            [this](const auto& key, const auto& attributes) { found(key, attributes); });
  }

  std::vector<std::string> services_;
};

}  // namespace iotcloud::drivers::lan
