#pragma once

#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/message.h>
#include <iotcloud/discovery/channel_look.h>

/// Forms (discovery/description/fields.h) of fields that have any bytes, for JSON, whose texts are UTF-8: base64, four
/// characters for three bytes whatever the bytes are. JSON writes some characters as six. \throws config::Error for a
/// text that is not base64.
namespace iotcloud::gateway {

/// Some bytes.
struct AsBase64 {
  static std::string to(const std::string& bytes);
  static void from(const std::string& text, std::string& bytes);
  static std::string to(const brokers::Payload& payload);
  static void from(const std::string& text, brokers::Payload& payload);
};

/// The properties of a message, as pairs of a key and a value.
struct AsBase64Pairs {
  static std::vector<std::pair<std::string, std::string>> to(const brokers::Properties& properties);
  static void from(const std::vector<std::pair<std::string, std::string>>& pairs, brokers::Properties& properties);
};

/// The payloads and the properties of the messages that were seen.
struct WithBase64 {
  static discovery::ChannelLook to(discovery::ChannelLook look);
  static void from(discovery::ChannelLook travelling, discovery::ChannelLook& look);
};

}  // namespace iotcloud::gateway
