// The properties of an AMQP message from a hostile publisher, read by librabbitmq and by this project.
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <amqp.h>
#include <amqp_framing.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

namespace {

using namespace iotcloud;

class AmqpPool {
 public:
  AmqpPool() { init_amqp_pool(&pool_, 4096); }
  AmqpPool(const AmqpPool&) = delete;
  AmqpPool& operator=(const AmqpPool&) = delete;
  ~AmqpPool() { empty_amqp_pool(&pool_); }
  amqp_pool_t* get() { return &pool_; }

 private:
  amqp_pool_t pool_{};
};

/// \return the properties, or null when the library refuses them.
const amqp_basic_properties_t* read_properties(std::string& bytes, AmqpPool& pool) {
  void* decoded = nullptr;
  if (amqp_decode_properties(AMQP_BASIC_CLASS, pool.get(), {bytes.size(), bytes.data()}, &decoded) < 0) return nullptr;
  return static_cast<const amqp_basic_properties_t*>(decoded);
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(amqp_headers, 30'000) {
  std::string input(fuzz::text(data, size));
  AmqpPool pool;
  const amqp_basic_properties_t* const properties = read_properties(input, pool);
  if (properties == nullptr) return;
  brokers::rabbitmq::origin_of(*properties);
  brokers::Message message;
  brokers::rabbitmq::decode_properties(*properties, message);
  if (brokers::refusal(message) != nullptr) return;

  // Every valid message must arrive unchanged.
  brokers::rabbitmq::MessageProperties encoder;
  amqp_basic_properties_t again = encoder.encode(message, {});
  std::string bytes(2 * brokers::max_metadata, '\0');
  const int length = amqp_encode_properties(AMQP_BASIC_CLASS, &again, {bytes.size(), bytes.data()});
  fuzz::must(length >= 0, "what is not refused fits into a frame");
  bytes.resize(static_cast<std::size_t>(length));
  AmqpPool second_pool;
  const amqp_basic_properties_t* const second = read_properties(bytes, second_pool);
  fuzz::must(second != nullptr, "what we write can be read");
  brokers::Message same;
  fuzz::must(!brokers::rabbitmq::decode_properties(*second, same), "nothing marks it as sent before");
  fuzz::must(same.driver_id == message.driver_id && same.gateway_id == message.gateway_id &&
                 same.time_ms == message.time_ms && same.properties == message.properties,
             "metadata arrive as they were");
}
