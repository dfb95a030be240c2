// A message as a hostile peer of ActiveMQ may send it, read by us.
#include <memory>
#include <string>

#include "iotcloud/brokers/activemq/wire/amqp_value.h"
#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include "iotcloud/brokers/limits.h"
#include "iotcloud/tests/fuzz/bytes.h"

namespace {

using namespace iotcloud;

std::optional<brokers::client::Arrived> decode(const std::string& bytes) {
  const auto owner = std::make_shared<const std::string>(bytes);
  return brokers::activemq::from_wire({owner, *owner});
}

void read_as_answer(const std::string& bytes) {
  try {
    brokers::activemq::statistics_answer(bytes);
  } catch (const brokers::activemq::MalformedAmqp&) {  // as it should be
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string input(fuzz::text(data, size));
  read_as_answer(input);
  const auto arrived = decode(input);
  if (!arrived || brokers::refusal(arrived->message) != nullptr) return 0;

  // What any broker may be given must arrive as it was, but for names that are the protocol's own.
  for (const char* reserved : {"sensorID", "siteID", "time", "iotcloud_properties", "iotcloud_resent"}) {
    if (arrived->message.properties.find(reserved) != nullptr) return 0;
  }
  std::string bytes;
  brokers::activemq::write_head(arrived->message, {.to = "queue://q"}, bytes);
  const auto same = decode(bytes + std::string(arrived->message.payload.text()));
  fuzz::must(same.has_value(), "what we write can be read");
  fuzz::must(same->message.payload == arrived->message.payload, "the payload arrives");
  fuzz::must(same->message.driver_id == arrived->message.driver_id, "the driver's id arrives");
  fuzz::must(same->message.gateway_id == arrived->message.gateway_id, "the gateway's id arrives");
  fuzz::must(same->message.time_ms == arrived->message.time_ms, "the time arrives");
  fuzz::must(same->message.properties == arrived->message.properties, "the properties arrive in their order");
  return 0;
}
