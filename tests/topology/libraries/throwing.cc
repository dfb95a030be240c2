#include <stdexcept>

#include <iotcloud/topology/plugin.h>

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  static_cast<void>(registry);
  throw std::runtime_error("no licence");
}
