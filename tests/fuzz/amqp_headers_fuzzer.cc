// The properties of an AMQP message as a hostile publisher may send them, read by librabbitmq and by us.
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <amqp.h>
#include <amqp_framing.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include "iotcloud/tests/fuzz/bytes.h"

namespace {

using namespace iotcloud;

class Pool {
 public:
  Pool() { init_amqp_pool(&pool_, 4096); }
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool() { empty_amqp_pool(&pool_); }
  amqp_pool_t* get() { return &pool_; }

 private:
  amqp_pool_t pool_{};
};

/// \return the properties, or null when the library refuses them.
const amqp_basic_properties_t* decode(std::string& bytes, Pool& pool) {
  void* decoded = nullptr;
  if (amqp_decode_properties(AMQP_BASIC_CLASS, pool.get(), {bytes.size(), bytes.data()}, &decoded) < 0) return nullptr;
  return static_cast<const amqp_basic_properties_t*>(decoded);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string input(fuzz::text(data, size));
  Pool pool;
  const amqp_basic_properties_t* const properties = decode(input, pool);
  if (properties == nullptr) return 0;
  brokers::rabbitmq::origin_of(*properties);
  brokers::Message message;
  brokers::rabbitmq::decode_properties(*properties, message);
  if (brokers::refusal(message) != nullptr) return 0;

  // What any broker may be given must arrive as it was.
  brokers::rabbitmq::MessageProperties encoder;
  amqp_basic_properties_t again = encoder.encode(message, {});
  std::string bytes(2 * brokers::max_metadata, '\0');
  const int length = amqp_encode_properties(AMQP_BASIC_CLASS, &again, {bytes.size(), bytes.data()});
  fuzz::must(length >= 0, "what is not refused fits into a frame");
  bytes.resize(static_cast<std::size_t>(length));
  Pool second_pool;
  const amqp_basic_properties_t* const second = decode(bytes, second_pool);
  fuzz::must(second != nullptr, "what we write can be read");
  brokers::Message same;
  fuzz::must(!brokers::rabbitmq::decode_properties(*second, same), "nothing marks it as sent before");
  fuzz::must(same.driver_id == message.driver_id && same.gateway_id == message.gateway_id &&
                 same.time_ms == message.time_ms && same.properties == message.properties,
             "metadata arrive as they were");
  return 0;
}
