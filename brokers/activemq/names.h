#pragma once

#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// How topics and groups are named on an ActiveMQ server. Each topic `T` is the virtual topic `VirtualTopic.T`; the
/// server copies what is sent there into every queue `Consumer.GROUP.VirtualTopic.T` there is. The topic's own queue is
/// `T`, as in the original system. Bytes that mean something to the server (wildcards, lists, options) are
/// percent-encoded, in a group also the dot.
std::string own_queue(std::string_view topic);
std::string group_queue(std::string_view topic, std::string_view group);
/// The queue that a subscription with this group (may be empty) reads.
std::string queue_of(std::string_view topic, std::string_view group);
/// Matches the topic's own queue and the queues of all its groups.
std::string queues_pattern(std::string_view topic);
/// Where to send what goes to all groups, and to the topic's own queue as well when `own`.
std::string send_address(std::string_view topic, bool own);

/// Percent-encodes all bytes but letters, digits and those of `kept`.
std::string percent_encode(std::string_view text, std::string_view kept);
/// Undoes it. What is no escape stays as it is.
std::string percent_decode(std::string_view text);

}  // namespace iotcloud::brokers::activemq
