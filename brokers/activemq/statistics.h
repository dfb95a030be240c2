#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <proton/message.hpp>

namespace iotcloud::brokers::activemq {

/// A queue, as the server's statistics describe it.
struct QueueFacts {
  std::string name;
  std::uint64_t readers = 0;
  std::uint64_t messages = 0;  ///< waiting or under way
};

/// A question to the server's statistics plug-in about queues that exist (names separated by commas, with wildcards;
/// empty: about nothing, only to see whether it answers). For each queue one message comes to `reply_to`, and one more
/// at the end.
proton::message statistics_question(const std::string& queues, const std::string& reply_to, std::uint64_t number);

struct StatisticsAnswer {
  std::uint64_t question = 0;
  std::optional<QueueFacts> facts;  ///< nothing: that was all
};

/// Reads one answer; `question` is 0 for a message that is none.
StatisticsAnswer statistics_answer(const proton::message& message);

}  // namespace iotcloud::brokers::activemq
