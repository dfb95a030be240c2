// A message from a hostile peer of ActiveMQ.
#include <memory>
#include <string>

#include "iotcloud/brokers/activemq/wire/amqp_value.h"
#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include "iotcloud/brokers/limits.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

namespace {

using namespace iotcloud;

std::optional<brokers::client::Arrived> read_wire(const std::string& bytes) {
  const auto owner = std::make_shared<const std::string>(bytes);
  return brokers::activemq::from_wire({owner, *owner});
}

void read_as_answer(const std::string& bytes) {
  try {
    brokers::activemq::statistics_answer(bytes);
  } catch (const brokers::activemq::MalformedAmqp&) {  // the expected error
  }
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(activemq_message, 10'000) {
  const std::string input(fuzz::text(data, size));
  read_as_answer(input);
  const auto arrived = read_wire(input);
  if (!arrived || brokers::refusal(arrived->message) != nullptr) return;

  // Every valid message must arrive unchanged, except for names that the protocol reserves.
  for (const char* reserved : {"sensorID", "siteID", "time", "iotcloud_properties", "iotcloud_resent"}) {
    if (arrived->message.properties.find(reserved) != nullptr) return;
  }
  std::string bytes;
  brokers::activemq::write_head(arrived->message, {.to = "queue://q"}, bytes);
  const auto same = read_wire(bytes + std::string(arrived->message.payload.text()));
  fuzz::must(same.has_value(), "what we write can be read");
  fuzz::must(same->message.payload == arrived->message.payload, "the payload arrives");
  fuzz::must(same->message.driver_id == arrived->message.driver_id, "the driver's id arrives");
  fuzz::must(same->message.gateway_id == arrived->message.gateway_id, "the gateway's id arrives");
  fuzz::must(same->message.time_ms == arrived->message.time_ms, "the time arrives");
  fuzz::must(same->message.properties == arrived->message.properties, "the properties arrive in their order");
}
