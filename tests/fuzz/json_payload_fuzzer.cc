// JSON that a stranger's program sends: the payload of a topology's `builder: json`, or a robot's command. The first
// byte chooses.
#include <cmath>
#include <exception>
#include <string>
#include <utility>

#include "iotcloud/drivers/turtle/command.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/topology/endpoints/json_builder.h"

using namespace iotcloud;

namespace {

const topology::Fields fields{"a", "b", "c", "d", "e"};

struct Received final : topology::detail::TupleData {
  Received() { handles = 1; }
  void recycle() noexcept override {}
};

topology::Values read(topology::Payload payload) {
  brokers::Message message;
  message.payload = std::move(payload);
  return topology::JsonBuilder().read(message, fields);
}

/// The payload of a tuple with these values.
topology::Payload written(const topology::Values& values) {
  const topology::detail::StreamInfo stream{.fields = fields};
  Received received;
  received.stream = &stream;
  received.values = values;
  brokers::Message message;
  topology::JsonBuilder().write(topology::Tuple(&received), fields, message);
  return message.payload;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(json_payload, 2'000) {
  if (size == 0) return;
  const std::string_view text = fuzz::text(data + 1, size - 1);
  if (*data % 2 == 1) {
    const auto velocity = drivers::turtle::parse_command(text);
    fuzz::must(!velocity || (std::isfinite(velocity->linear) && std::isfinite(velocity->angular)),
               "a command is two numbers");
    return;
  }
  topology::Values values;
  try {
    values = read(topology::Payload::copy(text));
  } catch (const std::exception&) {  // the message is given up
    return;
  }
  fuzz::must(values.size() == fields.size(), "each field has a value");
  const topology::Payload once = written(values);
  fuzz::must(written(read(once)).text() == once.text(), "what was read can be written and read again");
}
