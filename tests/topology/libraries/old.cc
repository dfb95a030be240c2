#include <iotcloud/topology/plugin.h>

extern "C" __attribute__((visibility("default"))) const iotcloud::topology::LibraryDescriptor*
iotcloud_topology_library() {
  static const iotcloud::topology::LibraryDescriptor descriptor{0, sizeof(iotcloud::topology::LibraryDescriptor),
                                                                iotcloud::topology::cxx_abi, nullptr};
  return &descriptor;
}
