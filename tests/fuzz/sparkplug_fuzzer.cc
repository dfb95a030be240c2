// Hostile payloads of Sparkplug B: messages of a node and two devices, each a byte for the topic, one for the size, and
// the payload.
#include <array>
#include <string>
#include <string_view>

#include "iotcloud/drivers/mqtt/sparkplug/sparkplug.h"
#include "iotcloud/drivers/mqtt/sparkplug/sparkplug_driver.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace sparkplug = drivers::mqtt::sparkplug;

namespace {

constexpr std::array topics{"spBv1.0/g/NBIRTH/n",   "spBv1.0/g/NDATA/n",   "spBv1.0/g/NDEATH/n",
                            "spBv1.0/g/DBIRTH/n/a", "spBv1.0/g/DDATA/n/a", "spBv1.0/g/DDEATH/n/a",
                            "spBv1.0/g/DBIRTH/n/b", "spBv1.0/g/DDATA/n/b"};

}  // namespace

IOTCLOUD_FUZZ_TARGET(sparkplug, 20'000) {
  std::string_view rest = fuzz::text(data, size);
  sparkplug::Node node;
  while (rest.size() >= 2) {
    const auto topic = sparkplug::parse_topic(topics.at(static_cast<unsigned char>(rest[0]) % topics.size()));
    fuzz::must(topic.has_value(), "it is a topic");
    const std::string_view bytes = rest.substr(2, static_cast<unsigned char>(rest[1]));
    rest.remove_prefix(2 + bytes.size());
    auto payload = sparkplug::decode(bytes);
    if (!payload) continue;
    const std::string written = sparkplug::encode(*payload);
    const auto again = sparkplug::decode(written);
    fuzz::must(again && sparkplug::encode(*again) == written, "what was written is read as the same");
    static_cast<void>(node.take(*topic, *payload));
    static_cast<void>(sparkplug::json_of(*topic, *payload));
  }
}
