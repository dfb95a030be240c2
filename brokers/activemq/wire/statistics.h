#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// What a server's statistics plug-in says of one of its queues.
struct QueueFacts {
  std::string name;
  std::uint64_t readers = 0;
  std::uint64_t messages = 0;  ///< those that are delivered and not settled included
};

/// The question about queues, as a message: names separated by commas, with wildcards. Each queue there is answers, and
/// then comes an empty answer. An empty name asks whether anybody answers at all.
std::string statistics_question(const std::string& queues, const std::string& reply_to, std::uint64_t number);

struct StatisticsAnswer {
  std::uint64_t question = 0;       ///< its number; 0 when it answers none
  std::optional<QueueFacts> facts;  ///< nothing: this was the last answer
};

/// \throws MalformedAmqp
StatisticsAnswer statistics_answer(std::string_view message);

}  // namespace iotcloud::brokers::activemq
