#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "iotcloud/brokers/activemq/wire/amqp_value.h"

namespace iotcloud::brokers::activemq {

/// The descriptor codes of a message's sections.
enum class Section : std::uint8_t {
  header = 0x70,
  delivery_annotations = 0x71,
  message_annotations = 0x72,
  properties = 0x73,
  application_properties = 0x74,
  data = 0x75,
  sequence = 0x76,
  value = 0x77,
  footer = 0x78,
};

/// The parts of a message that the client reads. Refers to the message's bytes.
struct Sections {
  std::uint64_t delivery_count = 0;  ///< number of earlier deliveries
  AmqpValue to;
  AmqpValue correlation_id;
  AmqpValue application_properties;  ///< a map, or null
  enum class Body { none, data, value, sequence } body = Body::none;
  std::vector<std::string_view> data;  ///< content of a data body, which may have several parts
  AmqpValue value;
};

/// \throws MalformedAmqp
Sections read_sections(std::string_view message);

}  // namespace iotcloud::brokers::activemq
