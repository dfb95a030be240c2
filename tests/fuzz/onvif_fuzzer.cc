// A hostile answer of WS-Discovery, to the question with the id "asked".
#include <string>

#include "iotcloud/drivers/lan/onvif_finder.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(onvif, 20'000) {
  static_cast<void>(drivers::lan::read_onvif_answer(
      fuzz::text(data, size), "10.0.0.1", {"asked", ""}, [](const auto& key, const auto& attributes) {
        fuzz::must(key.starts_with("onvif "), "a key is of its kind");
        fuzz::must(attributes.at("kind") == "onvif", "an attribute of a stranger takes no other's place");
      }));
}
