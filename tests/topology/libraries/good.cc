#include <iotcloud/config/log.h>
#include <iotcloud/topology/plugin.h>

namespace {
const iotcloud::config::Logger logger{"good"};

struct Echo : iotcloud::topology::BasicBolt {
  Echo() { logger.debug("an Echo is made"); }
  void execute(const iotcloud::topology::Tuple&, iotcloud::topology::BasicOutputCollector&) override {}
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Echo>("good.Echo");
}
