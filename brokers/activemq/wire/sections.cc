#include "iotcloud/brokers/activemq/wire/sections.h"

namespace iotcloud::brokers::activemq {
namespace {

using Kind = AmqpValue::Kind;

AmqpValue of_kind(AmqpReader& reader, Kind kind) {
  const AmqpValue value = reader.read();
  if (value.kind != kind) throw MalformedAmqp("a section of the wrong type");
  return value;
}

/// \return the list's field at this position; null when the list is shorter.
AmqpValue field(const AmqpValue& list, std::size_t place) {
  AmqpReader fields(list.bytes);
  AmqpValue value;
  for (std::size_t i = 0; i <= place; ++i) value = i < list.elements ? fields.read() : AmqpValue();
  return value;
}

void read_header(const AmqpValue& header, Sections& sections) {
  constexpr std::size_t delivery_count = 4;
  const AmqpValue count = field(header, delivery_count);
  if (count.kind == Kind::unsigned_number) sections.delivery_count = count.number;
}

void read_properties(const AmqpValue& properties, Sections& sections) {
  constexpr std::size_t to = 2;
  constexpr std::size_t correlation_id = 5;
  sections.to = field(properties, to);
  sections.correlation_id = field(properties, correlation_id);
}

}  // namespace

Sections read_sections(std::string_view message) {
  Sections sections;
  AmqpReader reader(message);
  while (!reader.at_end()) {
    switch (static_cast<Section>(reader.read_descriptor())) {
      case Section::header:
        read_header(of_kind(reader, Kind::list), sections);
        break;
      case Section::properties:
        read_properties(of_kind(reader, Kind::list), sections);
        break;
      case Section::application_properties:
        sections.application_properties = of_kind(reader, Kind::map);
        break;
      case Section::data:
        sections.body = Sections::Body::data;
        sections.data.push_back(of_kind(reader, Kind::binary).bytes);
        break;
      case Section::value:
        sections.body = Sections::Body::value;
        sections.value = reader.read();
        break;
      case Section::sequence:
        sections.body = Sections::Body::sequence;
        of_kind(reader, Kind::list);
        break;
      case Section::delivery_annotations:
      case Section::message_annotations:
      case Section::footer:
        of_kind(reader, Kind::map);
        break;
      default:
        throw MalformedAmqp("an unknown section");
    }
  }
  return sections;
}

}  // namespace iotcloud::brokers::activemq
