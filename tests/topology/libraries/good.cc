#include <iotcloud/topology/plugin.h>

namespace {
struct Echo : iotcloud::topology::BasicBolt {
  void execute(const iotcloud::topology::Tuple&, iotcloud::topology::BasicOutputCollector&) override {}
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Echo>("good.Echo");
}
