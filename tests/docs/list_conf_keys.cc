// Prints, as JSON, the keys of `conf` that our classes declare, for docs/reference/write.py.
#include <iostream>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iotcloud/examples/turtlebot_follower/follower.h>
#include <iotcloud/topology/state/stateful_bolt.h>
#include <iotcloud/topology/windows/window_options.h>

namespace {

nlohmann::ordered_json to_json(const std::vector<iotcloud::topology::ConfKey>& keys) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& key : keys)
    list.push_back({{"key", key.name}, {"value", key.value}, {"otherwise", key.otherwise}, {"text", key.text}});
  return list;
}

}  // namespace

int main() {
  const nlohmann::ordered_json all{{"windows", to_json(iotcloud::topology::window_conf_keys())},
                                   {"state", to_json(iotcloud::topology::state_conf_keys())},
                                   {"follower", to_json(turtlebot_follower::follower_conf_keys())}};
  std::cout << all.dump() << '\n';
}
