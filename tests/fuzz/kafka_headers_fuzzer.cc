// A Kafka record's headers, as any sender can write them: for each, a byte with the length of its name, the name, a
// byte with the length of its value, the value. A length of 255 is a value that is not there.
#include <memory>
#include <string>
#include <string_view>

#include <librdkafka/rdkafka.h>

#include "iotcloud/brokers/kafka/record.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

namespace {

constexpr unsigned char no_value = 255;

std::string_view take(std::string_view& left, std::size_t size) {
  const auto taken = left.substr(0, size);
  left.remove_prefix(taken.size());
  return taken;
}

unsigned char take_byte(std::string_view& left) {
  return left.empty() ? '\0' : static_cast<unsigned char>(take(left, 1).front());
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(kafka_headers, 20'000) {
  const std::unique_ptr<rd_kafka_headers_t, decltype(&rd_kafka_headers_destroy)> headers(rd_kafka_headers_new(4),
                                                                                         rd_kafka_headers_destroy);
  std::string_view left = fuzz::text(data, size);
  while (!left.empty()) {
    const std::string name(take(left, take_byte(left)));
    const unsigned char length = take_byte(left);
    const auto value = take(left, length == no_value ? 0 : length);
    rd_kafka_header_add(headers.get(), name.data(), static_cast<ssize_t>(name.size()),
                        length == no_value ? nullptr : value.data(), static_cast<ssize_t>(value.size()));
  }
  const auto read = brokers::kafka::read_headers(headers.get());
  if (!read) return;  // there are too many
  fuzz::must(read->bare_body || read->message.driver_id.empty(), "only a header for the driver makes a bare body");
}
