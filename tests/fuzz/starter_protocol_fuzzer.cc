// What a gateway asks the socket for at which systemd starts its driver hosts, and what it is answered: a stream of
// frames.
#include "iotcloud/processes/starter_protocol.h"
#include "iotcloud/tests/fuzz/frame_stream.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(starter_protocol, 30'000) {
  fuzz::read_frames(
      fuzz::text(data, size), [](const std::string& body) { fuzz::read_again(body, processes::decode_answer); },
      [](const std::string& body) { fuzz::read_again(body, processes::decode_request); });
}
