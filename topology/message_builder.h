#pragma once

#include <functional>
#include <memory>
#include <stdexcept>

#include <iotcloud/brokers/message.h>
#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/tuple.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

/// Turns messages into tuples, and tuples into messages, for the spouts and bolts whose YAML names it
/// (`builder: my.Builder`). The spout or bolt handles the fields that are metadata itself (driverID, time, gatewayID,
/// channel, redelivered, properties); the builder handles the others. Each task has an object of its own, whose calls
/// never overlap. A builder of spouts needs read() only, one of bolts write() only.
class MessageBuilder {
 public:
  virtual ~MessageBuilder() = default;

  /// For spouts. \param message lives during the call; copies of its payload share the bytes. \param fields the fields
  /// that the builder makes. \return their values, in order. \throws an exception for a message that cannot be read: it
  /// is given up at once, without further tries.
  virtual Values read(const brokers::Message& message, const Fields& fields) {
    static_cast<void>(message);
    static_cast<void>(fields);
    throw std::logic_error("this builder makes messages only; it has no read()");
  }

  /// For bolts. Fills in the message's payload, and properties if it likes. \param fields the tuple's fields that the
  /// builder turns into the message. \param message has its driver, its time and the properties that YAML names.
  /// \throws an exception: the tuple fails.
  virtual void write(const Tuple& tuple, const Fields& fields, brokers::Message& message) {
    static_cast<void>(tuple);
    static_cast<void>(fields);
    static_cast<void>(message);
    throw std::logic_error("this builder reads messages only; it has no write()");
  }
};

using MessageBuilderFactory = std::function<std::unique_ptr<MessageBuilder>()>;

}  // namespace iotcloud::topology
