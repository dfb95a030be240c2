#pragma once

#include <iotcloud/brokers/message.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

/// The tuple that a spout emits for a message, as the fields in its YAML say.
/// \param built the fields that the builder makes: payload_fields(). \param builder null for the forms `bytes` and
/// `text`. \throws what the builder throws, and std::length_error when it makes another number of values.
Values values_of(const brokers::Message& message, const EndpointDefinition& endpoint, const Fields& built,
                 MessageBuilder* builder, bool redelivered);

/// The message that a bolt sends for a tuple. One without a time gets the clock's. \throws what the builder throws, and
/// an exception for a tuple that lacks a field or has another kind of value in it.
brokers::Message message_of(const Tuple& tuple, const EndpointDefinition& endpoint, const Fields& built,
                            MessageBuilder* builder, const config::Clock& clock);

/// The endpoint with what makes its builder, if that is one of ours.
EndpointDefinition with_own_builder(EndpointDefinition endpoint);

}  // namespace iotcloud::topology
