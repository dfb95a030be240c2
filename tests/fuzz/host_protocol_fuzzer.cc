// What a driver host sends its gateway, and the other way round: a stream of frames.
#include "iotcloud/gateway/host/protocol.h"
#include "iotcloud/tests/fuzz/frame_stream.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace host = gateway::protocol;

IOTCLOUD_FUZZ_TARGET(host_protocol, 3'000) {
  fuzz::read_frames(
      fuzz::text(data, size), [](const std::string& body) { fuzz::read_again(body, host::decode_report); },
      [](const std::string& body) { fuzz::read_again(body, host::decode_command); });
}
