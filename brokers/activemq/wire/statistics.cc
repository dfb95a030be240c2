#include "iotcloud/brokers/activemq/wire/statistics.h"

#include <charconv>

#include "iotcloud/brokers/activemq/wire/amqp_value.h"
#include "iotcloud/brokers/activemq/wire/sections.h"

namespace iotcloud::brokers::activemq {
namespace {

using Kind = AmqpValue::Kind;

// Names that the server's plug-in understands; the second asks it to send an empty last answer.
constexpr std::string_view prefix = "ActiveMQ.Statistics.Destination";
constexpr std::string_view with_end = "ActiveMQ.Statistics.Destination.List.End.With.Null";

std::string name_of(std::string_view destination) {
  const auto scheme = destination.find("://");
  return std::string(scheme == std::string_view::npos ? destination : destination.substr(scheme + 3));
}

}  // namespace

std::string statistics_question(const std::string& queues, const std::string& reply_to, std::uint64_t number) {
  // A topic drops the question if no plug-in takes it.
  const std::string subject =
      queues.empty() ? "topic://" + std::string(prefix) + "none" : "queue://" + std::string(prefix) + queues;
  std::string bytes;
  AmqpWriter writer(bytes);
  writer.descriptor(static_cast<std::uint8_t>(Section::header));
  const std::size_t header = writer.begin_list();
  writer.boolean(false);  // durable
  writer.end(header, 1);
  writer.descriptor(static_cast<std::uint8_t>(Section::properties));
  const std::size_t properties = writer.begin_list();
  writer.null();  // message id
  writer.null();  // user
  writer.text(subject + std::string(with_end));
  writer.null();  // subject
  writer.text(reply_to);
  writer.text(std::to_string(number));
  writer.end(properties, 6);
  writer.descriptor(static_cast<std::uint8_t>(Section::value));
  writer.null();
  return bytes;
}

StatisticsAnswer statistics_answer(std::string_view message) {
  const Sections sections = read_sections(message);
  StatisticsAnswer answer;
  if (sections.correlation_id.kind != Kind::text) return answer;
  const std::string_view id = sections.correlation_id.bytes;
  std::from_chars(id.data(), id.data() + id.size(), answer.question);
  if (sections.body != Sections::Body::value || sections.value.kind != Kind::map) return answer;
  QueueFacts facts;
  bool named = false;
  AmqpReader entries(sections.value.bytes);
  for (std::size_t i = 0; i < sections.value.elements; i += 2) {
    const AmqpValue key = entries.read();
    const AmqpValue value = entries.read();
    if (key.kind != Kind::text) continue;
    if (key.bytes == "destinationName" && value.kind == Kind::text) {
      facts.name = name_of(value.bytes);
      named = true;
    } else if (value.kind == Kind::signed_number) {
      if (key.bytes == "consumerCount") facts.readers = value.number;
      if (key.bytes == "size") facts.messages = value.number;
    }
  }
  if (named) answer.facts = std::move(facts);
  return answer;
}

}  // namespace iotcloud::brokers::activemq
