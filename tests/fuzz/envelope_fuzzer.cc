// The envelope of Kafka's records (a Thrift struct that the project parses by hand), as anybody may write it.
#include <span>
#include <string>

#include "iotcloud/brokers/envelope.h"
#include "iotcloud/brokers/limits.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(envelope, 50'000) {
  const std::string_view input = fuzz::text(data, size);
  auto opened = brokers::open_envelope(std::as_bytes(std::span(input)));
  if (!opened) return;
  fuzz::must(opened->body.size() <= size, "the body lies in the bytes");
  brokers::Message message = opened->message;
  message.payload = brokers::Payload::copy(opened->body);
  message.time_ms = opened->time_ms.value_or(0);
  if (brokers::refusal(message) != nullptr) return;

  // Every valid message must arrive unchanged.
  const brokers::EnvelopeBytes bytes = brokers::encode_envelope(message);
  const auto same = brokers::open_envelope(std::span(bytes.data.get(), bytes.size));
  fuzz::must(same.has_value(), "what we write can be read");
  fuzz::must(same->message.driver_id == message.driver_id && same->message.gateway_id == message.gateway_id &&
                 same->time_ms == message.time_ms && brokers::Payload::copy(same->body) == message.payload &&
                 same->message.properties.size() == message.properties.size(),
             "a message arrives as it was");
  for (const auto& [name, value] : message.properties) {
    const std::string* const found = same->message.properties.find(name);
    fuzz::must(found != nullptr && *found == value, "a property arrives as it was");
  }
}
