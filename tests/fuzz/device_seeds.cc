// First inputs of what finds devices, without a library that a build may lack.
#include <string>

#include "iotcloud/tests/drivers/lan/dns_answer.h"
#include "iotcloud/tests/drivers/lan/probe_match.h"
#include "iotcloud/tests/fuzz/seeds.h"

namespace iotcloud::fuzz {

namespace {

std::string message(const std::string& topic, const std::string& payload) {
  return topic + '\n' + payload + '\0';
}

/// What begins a field of protobuf.
std::string tag(int number, int wire_type) {
  const int both = number << 3 | wire_type;
  if (both < 0x80) return {static_cast<char>(both)};
  return {static_cast<char>((both & 0x7f) | 0x80), static_cast<char>(both >> 7)};
}
/// A number below 128.
std::string field(int number, int value) {
  return tag(number, 0) + static_cast<char>(value);
}
std::string field(int number, const std::string& bytes) {
  return tag(number, 2) + static_cast<char>(bytes.size()) + bytes;
}

// The numbers of fields are those of drivers/mqtt/sparkplug/payload.proto.
std::string metric(const std::string& name, int alias, int type, const std::string& value) {
  return field(2, (name.empty() ? "" : field(1, name)) + (alias == 0 ? "" : field(2, alias)) +
                      (type == 0 ? "" : field(4, type)) + value);
}
std::string payload(int seq, const std::string& metrics) {
  return field(1, 100) + metrics + field(3, seq);
}
std::string told(int topic, const std::string& bytes) {
  return std::string{static_cast<char>(topic), static_cast<char>(bytes.size())} + bytes;
}

SeedsOfTarget announcements() {
  const std::string lamp = message(
      "homeassistant/light/kitchen/lamp/config",
      R"({"~":"home/lamp","stat_t":"~","cmd_t":"~/set","bri_cmd_t":"~/level/set","dev":{"ids":["k1","k2"],"mf":"Acme"},)"
      R"("avty":[{"t":"home/lwt","pl_avail":"up"}]})");
  return {{"entity", lamp},
          {"moves", lamp + message("homeassistant/light/kitchen/lamp/config",
                                   R"({"state_topic":"a","device":{"connections":[["mac","02:00"]]}})")},
          {"whole", message("homeassistant/device/k3/config",
                            R"({"dev":{"ids":"k3"},"o":{"name":"x"},"cmps":{"t":{"p":"sensor","stat_t":"a/t"},)"
                            R"("h":{"p":"sensor","stat_t":"a/t","uniq_id":"h"}},"avty_t":"a/~"})")},
          {"strange", message("homeassistant/sensor/a/config", R"({"stat_t":"#,x=y","uniq_id":7,"cmd_t":"$SYS/x"})") +
                          message("devices/7/hello", R"({"id":"7","port":1502,"tls":true,"deep":{"a":[1]}})") +
                          message("devices/7/hello", "")}};
}

SeedsOfTarget sparkplug() {
  const std::string session = metric("bdSeq", 0, 4, field(11, 3));
  const std::string birth = told(0, payload(0, session + metric("Speed", 3, 3, field(10, 5)))) +
                            told(3, payload(1, metric("Name", 4, 12, field(15, "press"))));
  const std::string data =
      told(1, payload(2, metric("", 3, 0, field(10, 6)))) + told(4, payload(3, metric("", 4, 0, field(15, "other"))));
  return {{"life", birth + data + told(5, payload(4, "")) + told(2, session)},
          {"gap", birth + told(1, payload(9, metric("", 9, 0, field(14, 1))))},
          {"opaque", told(0, payload(0, session + metric("Set", 5, 16, field(17, field(1, 2))) +
                                            metric("Bytes", 6, 17, field(16, "bytes"))))}};
}

}  // namespace

void add_device_seeds(Seeds& seeds) {
  namespace lan = drivers::lan;
  seeds["announcements"] = announcements();
  seeds["sparkplug"] = sparkplug();
  seeds["mdns"] = {{"service", lan::answer("Front Door.1")}, {"gone", lan::answer("a", 0)}};
  seeds["onvif"] = {{"camera", lan::probe_match("asked")}, {"stranger", lan::probe_match("other")}};
}

}  // namespace iotcloud::fuzz
