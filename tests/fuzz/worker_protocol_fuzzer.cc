// What a worker sends its pool, and the other way round: a stream of frames.
#include "iotcloud/tests/fuzz/frame_stream.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/topology/pool/worker_protocol.h"

using namespace iotcloud;
namespace pooled = topology::pooled;

IOTCLOUD_FUZZ_TARGET(worker_protocol, 6'000) {
  fuzz::read_frames(
      fuzz::text(data, size), [](const std::string& body) { fuzz::read_again(body, pooled::decode_report); },
      [](const std::string& body) { fuzz::read_again(body, pooled::decode_command); });
}
