// Hostile announcements of devices by MQTT: messages that end with a zero byte, each a topic, a line feed and a
// payload, for Home Assistant's discovery and as plain objects.
#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <string_view>

#include "iotcloud/drivers/mqtt/finder/announcements.h"
#include "iotcloud/drivers/mqtt/mqtt_driver.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace mqtt = drivers::mqtt;

namespace {

/// What was found, and is there.
struct Things {
  mqtt::Findings findings() {
    return {[this](const std::string& key, const drivers::PropertyMap& attributes) { found[key] = attributes; },
            [this](const std::string& key) { found.erase(key); }, [](const std::string&) {}};
  }
  std::map<std::string, drivers::PropertyMap> found;
};

/// The lists are those of topics that the driver mqtt takes, and of nothing else that it would understand.
void check(const drivers::PropertyMap& attributes) {
  if (const auto list = attributes.find("subscribe"); list != attributes.end()) {
    for (const auto& subscription : mqtt::read_subscriptions(list->second)) {
      fuzz::must(subscription.filter.find_first_of("#+") == std::string::npos,
                 "an announcement subscribes to no others");
      fuzz::must(!subscription.filter.starts_with('$'), "nor to what is the broker's own");
    }
  }
  if (const auto list = attributes.find("publish_to"); list != attributes.end())
    static_cast<void>(mqtt::read_targets(list->second));
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(announcements, 20'000) {
  std::string_view rest = fuzz::text(data, size);
  Things things, objects;
  mqtt::HomeAssistant house("homeassistant", things.findings());
  mqtt::PlainAnnouncements plain(objects.findings());
  std::set<std::string> topics;
  while (!rest.empty()) {
    const std::string_view message = rest.substr(0, rest.find('\0'));
    rest.remove_prefix(std::min(message.size() + 1, rest.size()));
    const std::string topic(message.substr(0, message.find('\n')));
    const std::string_view payload = message.substr(std::min(topic.size() + 1, message.size()));
    topics.insert(topic);
    house.take(topic, payload);
    plain.take(topic, payload);
  }
  for (const auto& [key, attributes] : things.found) check(attributes);
  for (const std::string& topic : topics) {
    house.take(topic, "");
    plain.take(topic, "");
  }
  fuzz::must(things.found.empty() && objects.found.empty(), "what is taken back is gone");
}
