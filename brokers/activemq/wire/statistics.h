#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace iotcloud::brokers::activemq {

/// The report of a server's statistics plug-in about one of its queues.
struct QueueFacts {
  std::string name;
  std::uint64_t readers = 0;
  std::uint64_t messages = 0;  ///< includes delivered but unsettled ones
};

/// A message that asks about queues: names separated by commas, with wildcards. Each existing queue answers, and an
/// empty answer follows. An empty name asks whether anybody answers at all.
std::string statistics_question(const std::string& queues, const std::string& reply_to, std::uint64_t number);

struct StatisticsAnswer {
  std::uint64_t question = 0;       ///< number of the question; 0 if this answers none
  std::optional<QueueFacts> facts;  ///< empty: this was the last answer
};

/// \throws MalformedAmqp
StatisticsAnswer statistics_answer(std::string_view message);

}  // namespace iotcloud::brokers::activemq
