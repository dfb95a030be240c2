#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/records.h>

/// How a person looks at a channel of a driver instance: the question, and the driver host's answer, which gateway,
/// master and command line pass on.
namespace iotcloud::discovery {

/// Limits of a look.
inline constexpr std::int32_t most_seen_messages = 64;
inline constexpr std::int32_t most_seen_bytes = 256 * 1024;

/// Asks for what a channel has carried since the last question of the same look.
struct LookRequest {
  InstanceId instance;
  std::string channel;     ///< empty: only the instance's state and its channels are wanted
  std::string look;        ///< names the look; the first question with a name begins it
  std::int32_t most = 0;   ///< messages in the answer at most, up to most_seen_messages; 0: they are only counted
  std::int32_t bytes = 0;  ///< of each message's payload at most, up to most_seen_bytes
  bool last = false;       ///< this is the last question
  /// Above 0: the first message of each so many milliseconds of the messages' own time is kept, with its times, and
  /// told when its end is known, or a second later. Workers choose the same messages (topology's page /trace).
  std::int32_t every_ms = 0;
  static constexpr const char* what = "a question about a channel";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, required),
                                            IOTCLOUD_FIELD(channel, usual),
                                            IOTCLOUD_FIELD(look, usual),
                                            IOTCLOUD_FIELD(most, usual),
                                            IOTCLOUD_FIELD(bytes, usual),
                                            IOTCLOUD_FIELD(last, usual),
                                            IOTCLOUD_FIELD_AS(every_ms, rare, "every_ms", everyMs)};
};

/// A message that a person hands to an instance, as if it had come on an incoming channel.
struct HandedMessage {
  InstanceId instance;
  std::string channel;
  std::string payload;
  std::map<std::string, std::string> properties;
  static constexpr const char* what = "a message by hand";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(channel, required),
                                            IOTCLOUD_FIELD(payload, usual), IOTCLOUD_FIELD(properties, usual)};
};

/// One message that a channel carried.
struct SeenMessage {
  std::int64_t number = 0;   ///< its place among those that the look has seen, from 1 on
  std::int64_t seen_ms = 0;  ///< wall time at which the host saw it
  std::int64_t time_ms = 0;  ///< brokers::Message::time_ms
  std::int64_t size = 0;     ///< bytes of the payload
  std::string payload;       ///< its beginning
  std::map<std::string, std::string> properties;
  // With LookRequest::every_ms, in microseconds of the clock that ChannelLook::clock names; 0: not known.
  std::int64_t came_us = 0;   ///< of an incoming channel: it came to this host
  std::int64_t begin_us = 0;  ///< its driver published it, or was given it
  std::int64_t end_us = 0;    ///< its broker has confirmed it, or gave it up; the driver has handled it
  std::string fate;           ///< what became of it: "confirmed", "handled", "failed", "dropped: superseded", ...
  static constexpr const char* what = "a message that was seen";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(number, usual),
                                            IOTCLOUD_FIELD_AS(seen_ms, usual, "seen_ms", seenMs),
                                            IOTCLOUD_FIELD_AS(time_ms, usual, "time_ms", timeMs),
                                            IOTCLOUD_FIELD(size, usual),
                                            IOTCLOUD_FIELD(payload, usual),
                                            IOTCLOUD_FIELD(properties, rare),
                                            IOTCLOUD_FIELD_AS(came_us, rare, "came_us", cameUs),
                                            IOTCLOUD_FIELD_AS(begin_us, rare, "begin_us", beginUs),
                                            IOTCLOUD_FIELD_AS(end_us, rare, "end_us", endUs),
                                            IOTCLOUD_FIELD(fate, rare)};
};

/// One channel of an instance, now.
struct ChannelState {
  std::string name;
  Direction direction = Direction::out;
  bool shared = false;
  std::string broker;          ///< the logical name
  std::string url;             ///< without its password
  std::string broker_state;    ///< "connected", "away", or "takes no messages"
  std::string broker_problem;  ///< why it is not connected; empty: it is, or nothing is known
  std::int64_t waiting = 0;    ///< messages that the broker has not confirmed, or that the driver has not taken
  std::int64_t oldest_ms = 0;  ///< the age of the oldest of them
  // Since the channel was opened:
  std::int64_t done = 0;                     ///< messages that the broker confirmed, or that the driver handled
  std::map<std::string, std::int64_t> lost;  ///< other messages, by what became of them: "dropped: superseded", ...
  static constexpr const char* what = "the state of a channel";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(name, usual),
                                            IOTCLOUD_FIELD_AS(direction, usual, "out", direction),
                                            IOTCLOUD_FIELD(shared, usual),
                                            IOTCLOUD_FIELD(broker, usual),
                                            IOTCLOUD_FIELD(url, usual),
                                            IOTCLOUD_FIELD_AS(broker_state, usual, "broker_state", brokerState),
                                            IOTCLOUD_FIELD_AS(broker_problem, rare, "broker_problem", brokerProblem),
                                            IOTCLOUD_FIELD(waiting, usual),
                                            IOTCLOUD_FIELD_AS(oldest_ms, usual, "oldest_ms", oldestMs),
                                            IOTCLOUD_FIELD(done, rare),
                                            IOTCLOUD_FIELD(lost, rare)};
};

/// A driver host's answer to a look, and to a message by hand.
struct ChannelLook {
  std::string problem;  ///< why nothing was done; empty: all below counts
  std::string state;    ///< the instance's state, as DriverState spells it; empty: not known
  std::string reason;   ///< why it is in that state
  std::vector<ChannelState> channels;
  // Of the look since it began:
  std::int64_t elapsed_us = 0;
  std::int64_t count = 0;   ///< messages that the channel carried
  std::int64_t bytes = 0;   ///< their payloads together
  std::int64_t missed = 0;  ///< messages that were to be shown and are in no answer, because they were too many
  // Since the look's last question:
  std::int64_t shortest_us = 0, longest_us = 0;  ///< between two messages; 0: there were no two
  std::int64_t smallest = 0, largest = 0;        ///< payloads
  std::vector<SeenMessage> messages;
  // Of the clock of the messages' times (config::system_clock_name()):
  std::string host;
  std::string clock;
  std::int64_t wall_us = 0;  ///< so much more are microseconds since 1970, as the host's machine has it
  static constexpr const char* what = "what is known of a channel";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(problem, rare),
                                            IOTCLOUD_FIELD(state, usual),
                                            IOTCLOUD_FIELD(reason, rare),
                                            IOTCLOUD_FIELD(channels, usual),
                                            IOTCLOUD_FIELD_AS(elapsed_us, usual, "elapsed_us", elapsedUs),
                                            IOTCLOUD_FIELD(count, usual),
                                            IOTCLOUD_FIELD(bytes, usual),
                                            IOTCLOUD_FIELD(missed, usual),
                                            IOTCLOUD_FIELD_AS(shortest_us, usual, "shortest_us", shortestUs),
                                            IOTCLOUD_FIELD_AS(longest_us, usual, "longest_us", longestUs),
                                            IOTCLOUD_FIELD(smallest, usual),
                                            IOTCLOUD_FIELD(largest, usual),
                                            IOTCLOUD_FIELD(messages, usual),
                                            IOTCLOUD_FIELD(host, rare),
                                            IOTCLOUD_FIELD(clock, rare),
                                            IOTCLOUD_FIELD_AS(wall_us, rare, "wall_us", wallUs)};
};

}  // namespace iotcloud::discovery
