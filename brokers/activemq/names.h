#pragma once

#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// Names of topics and groups on an ActiveMQ server. Each topic `T` is the virtual topic `VirtualTopic.T`; the server
/// copies its messages into every queue `Consumer.GROUP.VirtualTopic.T`. The topic's own queue is `T`, as in the
/// original system. Bytes with a meaning for the server (wildcards, lists, options) are percent-encoded, in a group
/// also the dot.
std::string own_queue(std::string_view topic);
std::string group_queue(std::string_view topic, std::string_view group);
/// The queue of a subscription with this group, which may be empty.
std::string queue_of(std::string_view topic, std::string_view group);
/// Matches the topic's own queue and the queues of all its groups.
std::string queues_pattern(std::string_view topic);
/// The address that reaches all groups, and the topic's own queue if `own`.
std::string send_address(std::string_view topic, bool own);

/// Percent-encodes all bytes but letters, digits and those in `kept`.
std::string percent_encode(std::string_view text, std::string_view kept);
/// Reverses percent_encode(); leaves malformed escapes unchanged.
std::string percent_decode(std::string_view text);

}  // namespace iotcloud::brokers::activemq
