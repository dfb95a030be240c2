#pragma once

#include <iotcloud/topology/message_builder.h>

namespace iotcloud::topology {

/// `builder: json`: the payload is a JSON object, and each field of the builder is the key of the same name. Texts,
/// whole numbers (64 bits), other numbers, true and false are strings, ints, doubles and bools; null, and a key that is
/// not there, is null; a list or an object within is its JSON as a string. The object may have other keys. A payload of
/// more than 16 MiB or 64 levels is refused. In the other direction, strings and payloads must be UTF-8 and become
/// texts.
class JsonBuilder final : public MessageBuilder {
 public:
  Values read(const brokers::Message& message, const Fields& fields) override;
  void write(const Tuple& tuple, const Fields& fields, brokers::Message& message) override;
};

}  // namespace iotcloud::topology
