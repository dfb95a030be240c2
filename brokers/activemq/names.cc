#include "iotcloud/brokers/activemq/names.h"

namespace iotcloud::brokers::activemq {
namespace {

constexpr std::string_view harmless = "-_~!$&'()+;=@/:#";

std::string topic_name(std::string_view topic) {
  return percent_encode(topic, std::string(harmless) + ".");
}

bool is_alphanumeric(char c) {
  return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

int hex_value(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

}  // namespace

std::string own_queue(std::string_view topic) {
  return topic_name(topic);
}

std::string group_queue(std::string_view topic, std::string_view group) {
  return "Consumer." + percent_encode(group, harmless) + ".VirtualTopic." + topic_name(topic);
}

std::string queue_of(std::string_view topic, std::string_view group) {
  return group.empty() ? own_queue(topic) : group_queue(topic, group);
}

std::string queues_pattern(std::string_view topic) {
  return own_queue(topic) + ",Consumer.*.VirtualTopic." + topic_name(topic);
}

std::string send_address(std::string_view topic, bool own) {
  const std::string groups = "topic://VirtualTopic." + topic_name(topic);
  return own ? "queue://" + own_queue(topic) + "," + groups : groups;
}

std::string percent_encode(std::string_view text, std::string_view kept) {
  constexpr std::string_view digits = "0123456789ABCDEF";
  std::string out;
  out.reserve(text.size());
  for (const char c : text) {
    if (is_alphanumeric(c) || kept.find(c) != std::string_view::npos) {
      out += c;
    } else {
      const auto byte = static_cast<unsigned char>(c);
      out += '%';
      out += digits[byte >> 4U];
      out += digits[byte & 15U];
    }
  }
  return out;
}

std::string percent_decode(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool escape = text[i] == '%' && i + 2 < text.size();
    const int high = escape ? hex_value(text[i + 1]) : -1;
    const int low = escape ? hex_value(text[i + 2]) : -1;
    if (high < 0 || low < 0) {
      out += text[i];
    } else {
      out += static_cast<char>(high * 16 + low);
      i += 2;
    }
  }
  return out;
}

}  // namespace iotcloud::brokers::activemq
