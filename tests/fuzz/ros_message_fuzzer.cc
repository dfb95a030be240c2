// Hostile bytes of a publisher of ROS 1: the definition of a type up to the first zero byte, then a message of it; and
// JSON of a stranger for the same type.
#include <algorithm>
#include <span>
#include <string>

#include "iotcloud/drivers/ros/message_type.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
using drivers::ros::MessageType;

namespace {

constexpr std::size_t most_bytes = 2000;

std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(ros_message, 20'000) {
  const std::string_view all = fuzz::text(data, size);
  const auto end = std::min(all.find('\0'), all.size());
  const std::string_view rest = all.substr(std::min(end + 1, all.size()));
  try {
    const MessageType type = MessageType::parse("a/B", all.substr(0, end));
    const MessageType again = MessageType::parse("a/B", type.definition());
    try {
      const std::string json = type.to_json(bytes_of(rest), most_bytes);
      fuzz::must(json.size() <= most_bytes, "JSON has its limit");
      fuzz::must(again.to_json(bytes_of(rest), most_bytes) == json, "a definition that is written is the same type");
      const std::string bytes = type.from_json(json, most_bytes);
      fuzz::must(type.to_json(bytes_of(bytes), most_bytes).size() <= most_bytes, "what was read can be written");
    } catch (const drivers::ros::FormatError&) {
    }
    fuzz::must(type.from_json(rest, most_bytes).size() <= most_bytes, "a message has its limit");
  } catch (const drivers::ros::DefinitionError&) {
  } catch (const drivers::ros::FormatError&) {
  }
}
