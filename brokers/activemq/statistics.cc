#include "iotcloud/brokers/activemq/statistics.h"

#include <charconv>
#include <map>
#include <string_view>

#include <proton/message_id.hpp>
#include <proton/types.hpp>

namespace iotcloud::brokers::activemq {
namespace {

// The plug-in's words; the second asks for a last answer after all others.
constexpr std::string_view prefix = "ActiveMQ.Statistics.Destination";
constexpr std::string_view with_end = "ActiveMQ.Statistics.Destination.List.End.With.Null";

std::uint64_t number_of(const proton::value& value) {
  switch (value.type()) {
    case proton::INT:
    case proton::LONG:
      return static_cast<std::uint64_t>(proton::coerce<std::int64_t>(value));
    default:
      return 0;
  }
}

}  // namespace

proton::message statistics_question(const std::string& queues, const std::string& reply_to, std::uint64_t number) {
  proton::message question;
  // A topic keeps nothing when no plug-in takes the question.
  const std::string subject =
      queues.empty() ? "topic://" + std::string(prefix) + "none" : "queue://" + std::string(prefix) + queues;
  question.to(subject + std::string(with_end));
  question.reply_to(reply_to);
  question.correlation_id(std::to_string(number));
  question.durable(false);
  return question;
}

StatisticsAnswer statistics_answer(const proton::message& message) {
  StatisticsAnswer answer;
  const proton::message_id id = message.correlation_id();
  if (id.type() != proton::STRING) return answer;
  const auto text = proton::get<std::string>(id);
  std::from_chars(text.data(), text.data() + text.size(), answer.question);
  if (message.body().type() != proton::MAP) return answer;
  std::map<std::string, proton::value> entries;
  proton::get(message.body(), entries);
  const auto name = entries.find("destinationName");
  if (name == entries.end() || name->second.type() != proton::STRING) return answer;
  QueueFacts facts;
  facts.name = proton::get<std::string>(name->second);
  const auto scheme = facts.name.find("://");
  if (scheme != std::string::npos) facts.name.erase(0, scheme + 3);
  facts.readers = number_of(entries["consumerCount"]);
  facts.messages = number_of(entries["size"]);
  answer.facts = std::move(facts);
  return answer;
}

}  // namespace iotcloud::brokers::activemq
