#pragma once

#include <string>

namespace iotcloud::topology::texts {

/// The paper's example, word for word (docs/wire.md#topology-files).
inline constexpr const char* paper_example = R"(zk.servers: ["server1:2181"]
zk.root: "/iot/sensors"
topology.name: "wordcount"
spouts:
  kinect_receive:
    broker: "rabbitmq"
    driver: "turtle"
    channel: "kinect"
    fields: ["frame", "driverID", "time"]
bolts:
  count_send:
    broker: "rabbitmq"
    driver: "turtle"
    channel: "control"
    fields: ["control", "driverID", "time"]
)";

/// Puts the lines before a spout's keys, which begin in line 5.
inline std::string with_spout(const std::string& spout) {
  return "zk.servers: [a:2181]\ntopology.name: t\nspouts:\n  s:\n" + spout;
}
inline const std::string good_spout = "    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f]\n";

/// Puts the lines before a bolt's keys, which begin in line 11.
inline std::string with_bolt(const std::string& bolt) {
  return with_spout(good_spout) + "bolts:\n  b:\n" + bolt;
}

}  // namespace iotcloud::topology::texts
