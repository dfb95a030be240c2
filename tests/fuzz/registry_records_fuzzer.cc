// Records in the registry, as anybody who may write to it can leave them: the first byte chooses which record a process
// takes the rest for.
#include <string>

#include "iotcloud/config/error.h"
#include "iotcloud/discovery/freeze.h"
#include "iotcloud/discovery/presence.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/submissions.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

namespace {

const std::string path = "/iot/x";

/// A record that can be read is written so that it is read again as the same.
/// Text that is not UTF-8 is replaced when it is written, so only what was written is compared.
template <typename Record>
void take(const std::string& bytes, Record (*decode)(const std::string&, const std::string&)) {
  try {
    const std::string once = discovery::encode(decode(bytes, path));
    fuzz::must(discovery::encode(decode(once, path)) == once, "what was read can be written and read again");
  } catch (const config::Error& error) {
    fuzz::must(std::string(error.what()).starts_with(path), "an error names the node");
  }
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(registry_records, 7'000) {
  if (size == 0) return;
  const std::string bytes(fuzz::text(data + 1, size - 1));
  switch (*data % 16) {
    case 0:
      return take(bytes, discovery::decode_order);
    case 1:
      return take(bytes, discovery::decode_drain);
    case 2:
      return take(bytes, discovery::decode_topology);
    case 3:
      return take(bytes, discovery::decode_topology_order);
    case 4:
      return take(bytes, discovery::decode_worker);
    case 5:
      return take(bytes, discovery::decode_life);
    case 6:
      return take(bytes, discovery::decode_reader);
    case 7:
      return take(bytes, discovery::decode_driver);
    case 8:
      return take(bytes, discovery::decode_channel);
    case 9:
      return take(bytes, discovery::decode_freeze);
    case 10:
      return take(bytes, discovery::decode_adoption);
    case 11:
      return take(bytes, discovery::decode_gateway);
    case 12:
      return take(bytes, discovery::decode_submission);
    case 13:
      return take(bytes, discovery::decode_pool);
    case 14:
      return take(bytes, discovery::decode_history);
    default:
      return take(bytes, discovery::decode_removal);
  }
}
