// A hostile answer of mDNS.
#include <string>

#include "iotcloud/drivers/lan/mdns_finder.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(mdns, 20'000) {
  constexpr std::size_t most_attributes = 64;
  static_cast<void>(drivers::lan::read_mdns_answer(
      fuzz::text(data, size), "10.0.0.1", {"_http._tcp", "_mqtt._tcp"}, [](const auto& key, const auto& attributes) {
        fuzz::must(key.starts_with("mdns "), "a key is of its kind");
        fuzz::must(attributes.size() <= most_attributes, "attributes have their limit");
        fuzz::must(attributes.at("kind") == "mdns", "an attribute of a stranger takes no other's place");
      }));
}
