#include <initializer_list>

#include <iotcloud/discovery/channel_names.h>

namespace iotcloud::discovery {

namespace {

/// The wire name made of the first of these properties that the record has.
std::string wire_name_of(const ChannelRecord& channel, std::initializer_list<const char*> properties) {
  for (const char* property : properties) {
    const auto found = channel.properties.find(property);
    if (found == channel.properties.end() || found->second.empty()) continue;
    const std::string prefix = wire_prefix(channel);
    const bool whole = found->second.starts_with(prefix) && channel.properties.contains("durable");
    return whole ? found->second : prefix + found->second;
  }
  return {};
}

}  // namespace

std::string wire_prefix(const ChannelRecord& channel) {
  std::string prefix = channel.gateway.str() + "." + channel.driver.str() + ".";
  if (!channel.shared) prefix += channel.instance.str() + ".";
  return prefix;
}

bool is_on_kafka(const ChannelRecord& channel) {
  const std::string& url = channel.broker_url;
  if (url.find("://") == std::string::npos) return channel.properties.contains("topic");
  return url.starts_with("kafka://") || url.starts_with("kafkas://");
}

std::string wire_name(const ChannelRecord& channel) {
  if (is_on_kafka(channel)) return wire_name_of(channel, {"topic", "routingKey", "queueName"});
  return wire_name_of(channel, {"routingKey", "queueName", "topic"});
}

std::string original_queue(const ChannelRecord& channel) {
  return wire_name_of(channel, {"queueName", "routingKey", "topic"});
}

}  // namespace iotcloud::discovery
